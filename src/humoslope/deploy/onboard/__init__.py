"""An exported policy on the motors of a robot: states, guards, links, a simulated robot, and the log of a walk.

Nothing here imports torch, warp or the environment. The state machine (`states`) and the guards (`guards`) are pure;
`session` runs them in time over a link, of which there are two: Unitree's SDK2 topics and one within the process.
"""
