"""The picture of a walk ends with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from humoslope.deploy import picture
from humoslope.deploy.player import Player


def test_a_fall_ends_the_picture(
    make_player: Callable[..., Player], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    player = make_player()
    monkeypatch.setattr(picture, "FINER", 1)
    monkeypatch.setattr(player.world, "fallen", lambda: player.world.data.time > 0.099)
    assert not picture.draw_walk(player, 2.0, 3, "", tmp_path / "fall.png")
    assert player.world.data.time == pytest.approx(0.1)
    with Image.open(tmp_path / "fall.png") as image:
        assert image.size == (picture.WIDTH, picture.HEIGHT)


def test_rays_go_through_the_picture_from_its_upper_left_corner() -> None:
    rays = picture._rays(np.array([2.0, 0.0, 0.0]), 4, 2).reshape(2, 4, 3)
    assert np.allclose(np.linalg.norm(rays, axis=2), 1.0)
    assert (rays[..., 0] > 0.9).all()
    assert (rays[:, 0, 1] > 0.0).all()  # left
    assert (rays[0, :, 2] > 0.0).all()  # up
    assert np.allclose(rays[0], rays[1] * (1.0, 1.0, -1.0))
