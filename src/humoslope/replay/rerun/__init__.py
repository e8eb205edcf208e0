"""A recorded walk in rerun."""
