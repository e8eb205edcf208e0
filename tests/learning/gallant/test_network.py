"""Gallant's network: its cells, its shapes, and the same actions from an ONNX file."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from humoslope.errors import UserError
from humoslope.export.onnx import largest_difference, network_inputs, translate
from humoslope.learning.gallant.network import GallantNetwork, Voxels
from humoslope.learning.policy import Actor, PolicySpec, Provenance
from humoslope.mdp.voxels import BOX
from humoslope.perception.columns import ColumnGrid

GROUPS = ("command", "proprioception", "last_actions", "voxels")
GAUSSIAN = {"class_name": "GaussianDistribution", "init_std": 0.8}


def spec(cell: float = 0.1, **changes: object) -> PolicySpec:
    columns = ColumnGrid(**BOX, cell=cell).side ** 2
    settings = {"grid": {**BOX, "cell": cell}, "hidden_dims": [256], "activation": "mish", "obs_normalization": True}
    shapes = ((4,), (384,), (116,), (columns,))
    return PolicySpec("gallant", GROUPS, shapes, 29, settings | {"distribution_cfg": GAUSSIAN} | changes)


def observations(of: PolicySpec, batch: int, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    groups = {n: torch.randn(batch, *s, generator=generator) for n, s in zip(of.groups, of.shapes, strict=True)}
    heights = -0.8 + 0.2 * groups["voxels"]
    groups["voxels"] = torch.where(torch.rand(heights.shape, generator=generator) < 0.02, -2.2, heights)
    return TensorDict(groups, batch_size=[batch])


def test_a_column_has_one_cell_where_its_ground_is_and_none_outside_of_the_box():
    grid = ColumnGrid(length=0.2, low=-1.2, high=0.8, cell=0.1)
    heights = torch.tensor([[-1.2, -0.75, 0.79, 0.81], [-1.21, grid.empty, -0.85, 0.0]])
    cells = Voxels(grid)(heights)
    assert cells.shape == (2, 20, 2, 2)
    assert cells[0].nonzero().tolist() == [[0, 0, 0], [4, 0, 1], [19, 1, 0]]
    assert cells[1].nonzero()[:, 1:].tolist() == [[1, 0], [1, 1]]
    assert cells[1, 3, 1, 0] == 1.0
    assert cells.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize(("cell", "features"), [(0.05, 128), (0.1, 32)])
def test_the_encoders_are_as_wide_as_the_originals(cell, features):
    network = spec(cell).build("cpu")
    assert isinstance(network, GallantNetwork)
    obs = observations(spec(cell), 3)
    levels = ColumnGrid(**BOX, cell=cell).levels
    convolutions = [layer for layer in network.voxels if isinstance(layer, torch.nn.Conv2d)]
    assert [(c.in_channels, c.out_channels, c.kernel_size, c.stride) for c in convolutions] == [
        (levels, 8, (3, 3), (2, 2)),
        (8, 8, (3, 3), (2, 2)),
        (8, 8, (3, 3), (2, 2)),
    ]
    assert network.voxels(obs["voxels"]).shape == (3, features)
    assert network.ground[0].in_features == features
    assert network.ground(network.voxels(obs["voxels"])).shape == (3, 64)
    assert network.proprioception[0].in_features == 504
    assert network.get_latent(obs).shape == (3, 320)
    assert network(obs).shape == (3, 29)


def test_it_has_some_300_000_weights_as_the_original():
    assert 280_000 < sum(p.numel() for p in spec(0.05).build("cpu").parameters()) < 320_000


def test_first_actions_are_next_to_zero():
    assert spec().build("cpu")(observations(spec(), 50)).abs().max() < 0.05


def test_what_it_normalises_are_the_vectors():
    network = spec().build("cpu")
    obs = observations(spec(), 500)
    network.update_normalization(obs)
    assert network.obs_normalizer.mean.numel() == 504
    before = network(obs)
    other = obs.clone()
    other["voxels"] = other["voxels"] + 1e-6 * (other["voxels"] < -2.0)  # empty columns stay empty
    torch.testing.assert_close(network(other), before)


def with_larger_weights(own: PolicySpec) -> torch.nn.Module:
    """A network whose weights are as large as those of a trained one."""
    torch.manual_seed(3)
    network = own.build("cpu").eval()
    for parameter in network.parameters():
        parameter.data.add_(0.05 * torch.randn_like(parameter))
    return network


def test_the_ground_matters_to_what_it_does():
    network = with_larger_weights(spec())
    obs = observations(spec(), 5)
    flat = obs.clone()
    flat["voxels"] = torch.full_like(obs["voxels"], -0.75)
    assert (network(obs) - network(flat)).abs().max() > 1e-3


@pytest.mark.usefixtures("shared_operators")
def test_an_onnx_file_of_it_acts_as_torch_does():
    own = spec()
    network = with_larger_weights(own)
    network.update_normalization(observations(own, 100, seed=1))
    actor = Actor(network, own, Provenance(Path("made-up.pt"), "0" * 64, "Gallant", 0, 0, None))
    obs = observations(own, 40, seed=2)
    assert [(end.name, end.shape[1:]) for end in network_inputs(actor, obs)] == list(
        zip(GROUPS, own.shapes, strict=True)
    )
    assert actor(obs).abs().max() > 0.1
    assert largest_difference(translate(actor, obs), actor, obs) < 1e-5


def test_columns_that_are_not_the_grids_are_refused():
    wrong = spec(grid={**BOX, "cell": 0.05})
    with pytest.raises(UserError, match="group 'voxels' has 256 columns, not 1024"):
        wrong.build("cpu")


def test_a_variant_is_a_remark_and_no_part_of_the_network():
    assert spec(variant="reduced").variant == "reduced"
    assert spec().variant == ""
    assert [p.shape for p in spec(variant="reduced").build("cpu").parameters()] == [
        p.shape for p in spec().build("cpu").parameters()
    ]
