"""Voxel columns: an observation of the ground in a box around the torso, as a slow, late and faulty sensor reports it.

The numbers are those of Gallant's LiDAR voxels (see docs/gallant.md); what is simulated is not the LiDARs but the
height of the ground in each column of the box. On a field of heights a column has one occupied cell, so its height
says as much as the column's cells, in a fraction of the memory; the policy's network makes cells of it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor

from humoslope.managers.observation import FaultyTerm
from humoslope.mdp import declare
from humoslope.mdp.declare import measured_as, mirrored_as, reads_bodies
from humoslope.perception.columns import ColumnGrid, column_heights
from humoslope.perception.frames import LateFrames
from humoslope.ranges import NotNegative, Positive, Share
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

BOX = {"length": 1.6, "low": -1.2, "high": 0.8}
"""The box in the torso's frame, m: +-0.8 m forward and to the sides; it reaches further down than up."""
FULL, REDUCED = 0.05, 0.1
"""Edge of a cell, m: the original's, and that of the preset for CPUs."""
RATE = 10.0
"""Frames per second."""
LAGS = (2, 3)
"""Frames by which what is seen is older than the newest, the usual and the longest one. The original draws 6 to 14
control steps and rounds up to whole frames: 2 frames in 5 episodes of 9, else 3."""
USUAL_SHARE = 5.0 / 9.0
HOLES = 0.02
"""Share of the columns that are empty in a frame."""
ANGLE_ERROR = math.radians(1.0)
"""Standard deviation of the torso's rotation about each axis, as it is known, rad."""
LARGEST_DEVIATION = 5.0
"""Bound on normally distributed numbers, in deviations: a uniform number of 24 bits may be exactly 0."""


def _image(env: Env, cell: float = FULL, **params: object) -> declare.Image:
    side = ColumnGrid(**BOX, cell=cell).side
    index = torch.arange(side * side).view(side, side).flip(1).flatten()
    return index, torch.ones(side * side)


@reads_bodies
@mirrored_as(_image)
@measured_as("custom")
class VoxelColumns(FaultyTerm):
    """Height of the ground in each column of a box around the torso, along the torso's up axis, m, [N, P].

    The columns stand on a square of 1.6 m, row by row from the rear, each row from the right; see `perception.columns`.
    A column in which nothing was seen has a height far below the box.

    A frame is taken every 0.1 s, counted from the start of the episode, and seen 2 or 3 frames late, as drawn for each
    episode: what is seen is 0.2 to 0.38 s old. In an episode the pose of the torso is known with one error; in a frame
    every height has an error of its own, and some columns are empty. Without noise (`enable_corruption`) only the lag
    of 2 frames is left. Off the robot's own tile the ground is that of the nearest place on it, as in `HeightScan`.

    Args:
        cell: Edge of a cell, m; it must divide 1.6 and 2.
        height_error: Standard deviation of a height, m.
        holes: Share of columns without a height.
        position_error: Standard deviation of the torso's position along each axis, m.
        angle_error: Standard deviation of its rotation about each axis, rad.

    Attributes:
        grid: The columns.
    """

    def __init__(
        self,
        env: Env,
        cell: Positive = FULL,
        height_error: NotNegative = 0.01,
        holes: Share = HOLES,
        position_error: NotNegative = 0.005,
        angle_error: NotNegative = ANGLE_ERROR,
    ) -> None:
        self.grid = ColumnGrid(**BOX, cell=cell)
        self._height_error, self._holes = height_error, holes
        self._errors = position_error, angle_error
        self._every = max(1, round(1.0 / (RATE * env.step_dt)))  # control steps from one frame to the next
        self._offsets = self.grid.offsets(env.device)  # [2, P]
        size = self._offsets.shape[1]
        self._frames = LateFrames(env, size, max(LAGS))
        self._frames.lag.fill_(LAGS[0])
        self._position = env.zeros(3)  # [N, 3] m, error of the episode
        self._turn = env.zeros(3)  # [N, 3] rad
        # A column and what an episode draws have a random number each; the shape of their source is its first use.
        self._drawn = torch.empty(env.num_envs, size + 7, device=env.device)

    @staticmethod
    def scale_to(preset: Literal["cpu", "gpu"]) -> dict[str, Any]:
        """Parameters that a preset sets: on a CPU the grid is reduced to a quarter of the columns."""
        return {"cell": REDUCED if preset == "cpu" else FULL}

    def __call__(self, env: Env) -> Tensor:
        steps = env.steps_since_reset
        fresh = steps == 0
        due = torch.remainder(steps, self._every) == 0
        if not env.sim.known_empty(due):
            uniform = None if self.noise_source is None else self.noise_source(env, self._drawn)
            if uniform is not None:
                self._begin_episodes(fresh, uniform[:, -7:])
            rows = env.sim.known_rows(due)
            frame = self.scan(env, rows)
            if uniform is not None:
                frame = self._with_faults(frame, uniform[rows, :-7])
            self._frames.add(rows, frame, due[rows], fresh[rows])
        return self._frames.read()

    def reset(self, mask: Tensor) -> None:
        """Nothing: the first call of an episode is known by the time since its start."""

    def scan(self, env: Env, rows: Tensor | slice = slice(None)) -> Tensor:
        """Heights [n, P] at present in the envs `rows`, with the episode's error of the torso's pose alone, m."""
        signals = env.signals
        position = env.bodies.position(env.robot.torso_body)[rows] + self._position[rows]
        rotation = quaternion.matrix(signals.torso_quat_w[rows])
        rotation = rotation @ quaternion.matrix(quaternion.from_rotation_vector(self._turn[rows]))

        def height(places: Tensor) -> Tensor:
            return env.terrain.height(env.tiles.nearest(places, rows).movedim(0, -1))

        below = height(position[:, :2].T[:, :, None])[:, 0]
        return column_heights(position, rotation, self._offsets, below, signals.slope_normal_w[rows], height)

    def _begin_episodes(self, fresh: Tensor, uniform: Tensor) -> None:
        """Draws the errors and the lag of the episodes that begin, from [N, 7]."""
        normal = _normal(uniform[:, :6])
        position, angle = self._errors
        self._position = torch.where(fresh[:, None], position * normal[:, :3], self._position)
        self._turn = torch.where(fresh[:, None], angle * normal[:, 3:], self._turn)
        longest = (uniform[:, 6] >= USUAL_SHARE).to(torch.int64)
        self._frames.lag = torch.where(fresh, LAGS[0] + longest * (LAGS[1] - LAGS[0]), self._frames.lag)

    def _with_faults(self, frame: Tensor, uniform: Tensor) -> Tensor:
        """The frame [n, P] with noise and holes, from one uniform number for each column."""
        left = (uniform - self._holes) / (1.0 - self._holes) if self._holes < 1.0 else uniform
        noisy = torch.add(frame, _normal(left), alpha=self._height_error)
        return torch.where(uniform < self._holes, self.grid.empty, noisy)


def grid_of(env: Env, group: str) -> ColumnGrid:
    """The columns that an observation group of an environment consists of."""
    (term,) = (term for _, term in env.cfg.observations[group].terms.items() if term.func is VoxelColumns)
    return ColumnGrid(**BOX, cell=term.params.get("cell", FULL))


def _normal(uniform: Tensor) -> Tensor:
    """Normally distributed numbers from uniform ones in [0, 1), by the inverse of the distribution."""
    deviations = math.sqrt(2.0) * torch.erfinv(2.0 * uniform - 1.0)
    return deviations.clamp(-LARGEST_DEVIATION, LARGEST_DEVIATION)
