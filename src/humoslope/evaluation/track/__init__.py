"""The held-out track: protocol, trials, metrics, and the store from which an evaluation continues."""
