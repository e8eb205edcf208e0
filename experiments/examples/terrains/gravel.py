import numpy as np

from humoslope.terrain import terrain
from terrains.profiles import ramp
from terrains.surfaces import rough


@terrain("gravel-ramp", grade=(0.0, 35.0))
def gravel_ramp(x: np.ndarray, y: np.ndarray, grade: float, rng: np.random.Generator) -> np.ndarray:
    """A planar ramp strewn with bumps."""
    return ramp(x, grade) + rough(x, y, rng, amplitude=0.02)
