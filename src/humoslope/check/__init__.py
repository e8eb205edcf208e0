"""Checks that an installation computes the right physics, never waits for the device in a step, and is fast."""
