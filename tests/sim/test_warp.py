"""What only the warp backend promises: no buffer overflows in silence."""

from __future__ import annotations

import mujoco
import pytest

from humoslope.errors import UserError
from humoslope.sim import make_simulation


@pytest.mark.parametrize(("sizes", "field"), [({"nconmax": 1}, "nconmax from 1"), ({"njmax": 5}, "njmax from 5")])
def test_a_full_buffer_is_reported_with_the_field_to_raise(
    rig: mujoco.MjModel, sizes: dict[str, int], field: str
) -> None:
    simulation = make_simulation(rig, 2, "warp", "cpu", **sizes)  # type: ignore[arg-type]
    simulation.step(5)  # the box settles on its four corners
    (report,) = simulation.warnings()
    assert f"raise {field}" in report
    assert ("8 contacts at the peak" in report) or ("12 rows at the peak" in report)
    assert simulation.warnings() == []
    simulation.step(1)
    assert len(simulation.warnings()) == 1


def test_what_mujoco_warp_cannot_do_is_a_sentence() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><option noslip_iterations='2'/></mujoco>")
    with pytest.raises(UserError, match="MuJoCo-Warp cannot run this model"):
        make_simulation(model, 1, "warp", "cpu")
