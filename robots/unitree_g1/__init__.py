"""Unitree G1, 29 actuated joints."""

from . import policies as policies
from .model import UNITREE_G1, UNITREE_G1_SOLID

__all__ = ["UNITREE_G1", "UNITREE_G1_SOLID"]
