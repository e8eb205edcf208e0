"""Policies that were trained elsewhere, made into export folders.

Each format has a reader (`mjlab`, `unitree`, `holosoma`) that returns one description, a `ForeignPolicy`; `folder`
writes it as an export. What a contract says in one way only (order of joints, layout of the history, bounds on
observations) is translated by nodes around the network (`rewire`), so that nothing that takes an export has to know
where it came from.
"""
