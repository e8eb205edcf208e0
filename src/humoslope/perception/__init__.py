"""What a robot perceives of the ground around it, computed from the terrain's heights, with a real sensor's faults.

`columns` is geometry, `frames` is time; the observation term that joins them is `humoslope.mdp.voxels`.
"""
