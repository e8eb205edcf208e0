"""Ground around each robot: a yaw-aligned height scan, and the plane that fits it best."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from humoslope.ranges import Range, check_config
from humoslope.scene.signals import Signals
from humoslope.scene.tiles import Tiles
from humoslope.slope.descriptor import Descriptor, terrain_descriptor
from humoslope.strict import StrictCfg
from humoslope.terrain.queries import TerrainQueries


@dataclass
class HeightScanCfg(StrictCfg):
    """Points of the ground that are scanned.

    Attributes:
        size: Number of points along each side of the square grid centred below the root. 7 x 7 = 49; the paper speaks
            of a compressed scan H49 and does not describe its layout.
        spacing: Distance between neighbouring points, m. 0.2 sees one stride ahead at 0.5 m/s. Ours.
        dead_band: Slope up to which the ground counts neither as up nor as down, rad. 3 degrees. Ours.
    """

    size: Annotated[int, Range(2, 64)] = 7
    spacing: Annotated[float, Range(0.001, 100.0)] = 0.2
    dead_band: Annotated[float, Range(0.0, 0.5 * math.pi, open_high=True)] = math.radians(3.0)


class HeightScan:
    """Scan and descriptor of the ground around each robot, computed on first use after a refresh of the signals.

    A point off the robot's own tile reads the ground at the nearest place of the tile, and is not valid. Beyond the
    edge lies another tile, in general at another height: the episode ends before the robot gets there (`off_tile`), so
    a cliff at the edge would announce nothing.
    """

    def __init__(self, cfg: HeightScanCfg, signals: Signals, terrain: TerrainQueries, tiles: Tiles) -> None:
        check_config("scene.height_scan", cfg)
        self.cfg = cfg
        self._signals, self._terrain, self._tiles = signals, terrain, tiles
        device = tiles.origin_w.device
        axis = (torch.arange(cfg.size, device=device) - 0.5 * (cfg.size - 1)) * cfg.spacing
        self._offsets = torch.cartesian_prod(axis, axis).T.contiguous()  # [2, P] m forward and left
        self._scanned: Tensor | None = None  # the root's place when the scan was made, new at every refresh
        self._described: Tensor | None = None

    @property
    def heights_w(self) -> Tensor:
        """Height of the ground at each point, world frame, m, [N, P]: rows from right to left, the rear row first."""
        self._scan()
        return self._heights_w

    @property
    def valid(self) -> Tensor:
        """Mask of the points on the robot's own tile, [N, P] bool."""
        self._scan()
        own_x, own_y = self._places == self._nearest
        return own_x & own_y

    @property
    def descriptor(self) -> Descriptor:
        """Plane that fits the valid points best, [N]."""
        self._scan()
        if self._described is not self._scanned:
            places = self._offsets.expand(len(self._heights_w), -1, -1)
            points = torch.cat((places, self._heights_w.unsqueeze(1)), dim=1)  # [N, 3, P]: what is summed lies together
            self._descriptor = terrain_descriptor(points.mT, self.valid, self.cfg.dead_band)
            self._described = self._scanned
        return self._descriptor

    def _scan(self) -> None:
        root, heading = self._signals.root_pos_w, self._signals.heading_w[:, None]
        if self._scanned is root:
            return
        cos, sin = heading.cos(), heading.sin()
        turn = torch.cat((cos, -sin, sin, cos), dim=1)  # [N, 4] rows of x and of y
        turn = turn.view(-1, 2, 2).transpose(0, 1).reshape(-1, 2)  # [2 N, 2] all x, then all y
        places = torch.addmm(root[:, :2].T.reshape(-1, 1), turn, self._offsets).view(2, len(root), -1)  # [2, N, P]
        nearest = self._tiles.nearest(places)
        self._places, self._nearest = places, nearest
        self._heights_w = self._terrain.height(nearest.movedim(0, -1))
        self._scanned = root
