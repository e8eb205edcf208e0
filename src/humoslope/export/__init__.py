"""Export of a trained policy to files that run without this framework."""
