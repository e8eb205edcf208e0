"""Display of a recorded walk in rerun."""
