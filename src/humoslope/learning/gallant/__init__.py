"""Gallant's learner: rsl_rl's PPO with a network that sees the ground in voxels.

`config` holds its numbers, `network` is actor and critic, `learner` what differs from the PPO of the other tasks.
"""
