"""HumoSlope: blind humanoid locomotion on steep slopes."""

import os

# Set before torch is loaded: its threads would otherwise spin for a while after each operation, on the cores that the
# physics needs next. `make bench` with OMP_WAIT_POLICY=active in the environment shows what that costs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = "0.1.0"
