"""Reusable terms that the managers call."""
