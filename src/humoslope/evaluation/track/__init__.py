"""The held-out track: protocol, trials, metrics, and the store that an evaluation goes on from."""
