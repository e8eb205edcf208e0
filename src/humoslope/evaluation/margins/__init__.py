"""Certificate of an export: the physical conditions up to which its policy succeeds, measured in plain MuJoCo.

Nothing here imports torch: the files of the export are the only source of information.
"""
