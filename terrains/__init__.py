"""Surfaces, profiles and training grids; importing this registers every terrain here."""

from terrains import kinds, stage1

__all__ = ["kinds", "stage1"]
