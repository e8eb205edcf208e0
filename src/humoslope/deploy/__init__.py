"""An exported policy in plain MuJoCo, from the files of the export alone.

Nothing here imports the environment, its managers or torch: what walks here walks by the contract.
"""
