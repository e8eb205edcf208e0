"""The ground around each robot: a yaw-aligned scan, and the plane that lies closest to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.scene.signals import Signals
from humoslope.scene.tiles import Tiles
from humoslope.slope.descriptor import Descriptor, terrain_descriptor
from humoslope.strict import Strict
from humoslope.terrain.queries import TerrainQueries


@dataclass
class PatchCfg(Strict):
    """The points of ground that are scanned.

    Attributes:
        size: Points along each side of the square grid centred below the root. 7 x 7 = 49, as in the paper's H49.
        spacing: Distance of the points, m. 0.2: one stride ahead at 0.5 m/s. Ours; the paper does not say.
        dead_band: Slope up to which the ground counts neither as up nor as down, rad. 3 degrees. Ours.
    """

    size: int = 7
    spacing: float = 0.2
    dead_band: float = math.radians(3.0)


class GroundPatch:
    """Scan and descriptor of the ground around each robot, computed when first asked for after the signals' refresh.

    A point off the robot's own tile reads the ground at the nearest place of the tile, and is not valid. What lies
    there is another tile, in general at another height: the robot's episode ends before it gets there (`off_tile`), so
    that a cliff at the edge would tell of nothing to come.
    """

    def __init__(self, cfg: PatchCfg, signals: Signals, terrain: TerrainQueries, tiles: Tiles) -> None:
        if cfg.size < 2 or not 0.0 < cfg.spacing < math.inf:
            raise UserError("scene.patch: size must be at least 2, and spacing positive, in m.")
        if not 0.0 <= cfg.dead_band < 0.5 * math.pi:
            raise UserError(f"scene.patch: dead_band {cfg.dead_band:g} must be from 0 to less than pi/2, in rad.")
        self.cfg = cfg
        self._signals, self._terrain, self._tiles = signals, terrain, tiles
        device = tiles.origin_w.device
        axis = (torch.arange(cfg.size, device=device) - 0.5 * (cfg.size - 1)) * cfg.spacing
        self._offsets = torch.cartesian_prod(axis, axis)  # [P, 2] m forward and left
        self._half_tile = 0.5 * torch.tensor([tiles.length, tiles.width], device=device)  # [2] m
        self._to_centre = self._half_tile * torch.tensor([1.0, 0.0], device=device)  # [2] m from the tile's start
        self._scanned: Tensor | None = None  # the root's place when the scan was made, new at every refresh
        self._described: Tensor | None = None

    @property
    def heights_w(self) -> Tensor:
        """Height of the ground at each point, world frame, m, [N, P]: rows from right to left, the rearmost first."""
        self._scan()
        return self._heights_w

    @property
    def valid(self) -> Tensor:
        """Which points lie on the robot's own tile, [N, P] bool."""
        self._scan()
        return self._valid

    @property
    def descriptor(self) -> Descriptor:
        """The plane that lies closest to the valid points, [N]."""
        self._scan()
        if self._described is not self._scanned:
            points = torch.cat((self._offsets.expand(len(self._valid), -1, -1), self._heights_w.unsqueeze(-1)), dim=-1)
            self._descriptor = terrain_descriptor(points, self._valid, self.cfg.dead_band)
            self._described = self._scanned
        return self._descriptor

    def _scan(self) -> None:
        root, heading = self._signals.root_pos_w, self._signals.heading_w
        if self._scanned is root:
            return
        cos, sin = heading.cos(), heading.sin()
        axes = torch.stack((cos, sin, -sin, cos), dim=1).view(-1, 2, 2)  # forward and left, world frame
        centre = (self._tiles.origin_w[:, :2] + self._to_centre).unsqueeze(1)
        places = (root[:, :2].unsqueeze(1) - centre) + self._offsets @ axes  # [N, P, 2] from the tile's centre
        nearest = places.clamp(-self._half_tile, self._half_tile)
        self._valid = (places == nearest).all(dim=-1)
        self._heights_w = self._terrain.height(nearest + centre)
        self._scanned = root
