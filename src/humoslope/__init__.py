"""HumoSlope: blind humanoid locomotion on steep slopes."""

__version__ = "0.1.0"
