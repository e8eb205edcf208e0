"""Playback of an exported policy in plain MuJoCo, from the files of the export alone.

Nothing here imports the environment, its managers or torch: the contract is the only source of information.
"""
