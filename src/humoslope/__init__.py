"""HumoSlope: blind humanoid locomotion on steep slopes."""

import os

# Set before torch is loaded. Its threads stay awake after an operation, by default for milliseconds, on the cores that
# the physics needs next; were they to sleep at once, every small operation of an update would wait for them to wake. So
# they stay awake for some tenths of a millisecond. `make bench` with GOMP_SPINCOUNT=0 or 3000000 in the environment
# shows what either costs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # where torch does not come with GNU's OpenMP
os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"
