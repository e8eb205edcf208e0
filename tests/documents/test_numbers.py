"""Settings that the pages state are those of the code. If a sentence is rephrased, change its claim here too."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from humoslope.mdp import harness, zmp
from humoslope.mdp.curricula import TerrainLevels
from humoslope.presets import apply_preset
from humoslope.registry import build_task
from humoslope.slope import bsga
from tasks.stage1 import STRICT, randomisation, stage1
from tasks.stage2 import stage2
from terrains.kinds import STEEPEST

DOCS = Path(__file__).parents[2] / "docs"


def text(page: str) -> str:
    return re.sub(r"\s+", " ", (DOCS / page).read_text(encoding="utf-8"))


def default(func: Callable[..., Any], name: str) -> Any:
    return inspect.signature(func).parameters[name].default


def regulariser(name: str) -> Any:
    return default(zmp.ZmpRegulariser, name)


def span(event: str, parameter: str) -> tuple[str, str]:
    low, high = randomisation()[event].params[parameter]
    return f"{low:g}", f"{high:g}"


def ms(event: str, parameter: str) -> tuple[str, str]:
    low, high = randomisation()[event].params[parameter]
    return f"{1e3 * low:g}", f"{1e3 * high:g}"


def one(event: str, parameter: str, factor: float = 1.0) -> str:
    return f"{factor * randomisation()[event].params[parameter]:g}"


def preset(name: str) -> tuple[str, ...]:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    apply_preset(cfg, name)
    sim, agent = cfg.env.sim, cfg.agent
    return str(cfg.env.num_envs), f"{1e3 * sim.timestep:g}", str(sim.decimation), *map(str, agent.hidden_dims)


def withdrawal_setting(name: str) -> float:
    return stage1().env.curriculum.harness.params.get(name, default(harness.HarnessCurriculum, name))


def level_share(name: str) -> str:
    return f"{100 * default(TerrainLevels, name):g}"


def withdrawal() -> tuple[str, str]:
    """Falls per second, and percentage of the commanded speed, at which Stage I's harness goes."""
    return f"{withdrawal_setting('falls_per_second'):g}", f"{100 * withdrawal_setting('speed_share'):g}"


def skill_withdrawal() -> tuple[str, str]:
    """Falls per second, and percentage of what is commanded, at which robots lose the harness of a skill."""
    falls, share = (default(harness.SkillCurriculum, name) for name in ("falls_per_second", "share"))
    return f"{falls:g}", f"{100 * share:g}"


CLAIMS: dict[tuple[str, str], Callable[[], tuple[str, ...]]] = {
    (
        "method.md",
        r"who do it fall less than (\S+) times per second \*and\* do more than (\S+) % of what is asked",
    ): skill_withdrawal,
    ("method.md", r"(\S+) m \(half a foot\), (\S+) N, (\S+) per second"): lambda: (
        f"{regulariser('sigma'):.2f}",
        f"{regulariser('epsilon'):g}",
        f"{stage1().env.rewards.zmp.weight:g}",
    ),
    ("method.md", r"cut at (\S+) m/s², averaged with weight (\S+) on the past"): lambda: (
        f"{regulariser('acc_limit'):g}",
        f"{regulariser('smoothing'):g}",
    ),
    ("method.md", r"below a pressure of (\S+) m/s²; deviations are cut at (\S+) m"): lambda: (
        f"{regulariser('least_pressure'):g}",
        f"{regulariser('largest_deviation'):g}",
    ),
    ("method.md", r"below (\d+) % of body weight on the feet"): lambda: (f"{100 * regulariser('flight_share'):g}",),
    ("method.md", r"fall less than (\S+) times per second \*and\* walk more than (\d+) %"): withdrawal,
    ("method.md", r"strictness grows while they fall less than (\S+) times per second"): lambda: (
        f"{withdrawal_setting('falls_unaided'):g}",
    ),
    ("faq.md", r"fewer than (\S+) falls per second \*and\* more than (\d+) %"): withdrawal,
    ("guides/laptop.md", r"falls, below (\S+) before .*? rises, over (\d+) %"): withdrawal,
    ("method.md", r"The deviation counts as (\S+) at"): lambda: (f"{stage1().agent.least_obs_std:g}",),
    ("concepts/terrain.md", r"walked (\d+) % of its tile, or on a hillside (\d+) % .*?, for (\d+) s"): (
        lambda: (*(2 * (level_share("up"),)), f"{default(TerrainLevels, 'least_s'):g}")
    ),
    ("concepts/terrain.md", r"walked less than (\d+) % of what was asked"): lambda: (level_share("down"),),
    ("method.md", r"held still for (\d+) iterations"): lambda: (str(stage2().agent.critic_warmup_iterations),),
    ("method.md", r"h_\\mathrm\{nom\}\$ (\S+) m, \S+ \+(\d) cm, \S+ -(\d) cm"): lambda: (
        f"{stage2().env.rewards.com_height.params['nominal']:g}",
        f"{100 * bsga.OFFSET_UP:g}",
        f"{-100 * bsga.OFFSET_DOWN:g}",
    ),
    ("method.md", r"h_\\mathrm\{tgt\}\)/(\S+)\)\^2\)"): lambda: (f"{bsga.COM_STD:.2f}",),
    ("method.md", r"s\^\* = (\S+) \+ (\S+)\\rho"): lambda: (f"{bsga.HIP_SHARE:.2f}", f"{bsga.HIP_SHARE_RISE:.2f}"),
    ("method.md", r"\(q - q\^\*\)/(\S+)\)\^2\) \\min\(s/(\S+), 1\)"): lambda: (
        f"{bsga.KNEE_STD:g}",
        f"{bsga.BRAKE_SHARE:g}",
    ),
    ("method.md", r"q\^\* = (\S+) \+ (\S+)\\rho\$ rad"): lambda: (
        f"{bsga.KNEE_FLEXION:.2f}",
        f"{bsga.KNEE_FLEXION_RISE:.2f}",
    ),
    ("method.md", r"L\^\* = \((\S+)\\,\\mathrm s \\cdot v \+ (\S+)\\,\\mathrm m\)\(1 - (\S+)\\rho\)"): lambda: (
        f"{bsga.STEP_TIME:g}",
        f"{bsga.STEP_MARGIN:g}",
        f"{bsga.STEP_SHORTENING:g}",
    ),
    ("method.md", r"L - L\^\*\)/(\S+)\)"): lambda: (f"{bsga.STRIDE_STD:.2f}",),
    ("method.md", r"q\^\*_\\mathrm\{swing\}\)/(\S+)\)\^2\)"): lambda: (f"{bsga.SWING_STD:g}",),
    ("method.md", r"\\rho = \\min\(\|\\theta_\\mathrm\{slope\}\| / (\d+)°, 1\)"): lambda: (
        f"{math.degrees(bsga.FULL_SLOPE):.0f}",
    ),
    ("method.md", r"Up and down begin beyond (\d) degrees"): lambda: (
        f"{math.degrees(stage2().env.scene.height_scan.dead_band):.0f}",
    ),
    ("concepts/terrain.md", r"is the (\d) x (\d) scan around the root, (\S+) m apart"): lambda: (
        *(2 * (str(stage1().env.scene.height_scan.size),)),
        f"{stage1().env.scene.height_scan.spacing:g}",
    ),
    ("concepts/terrain.md", r"ground.grade\[9, 0\] == (\S+) "): lambda: (str(STEEPEST),),
    ("concepts/randomisation.md", r"place of its centre \| (\S+) to (\S+) kg, ±(\S+) cm"): lambda: (
        *span("mass", "added"),
        one("com", "offset", 100.0),
    ),
    ("concepts/randomisation.md", r"every link's mass and inertia \| x (\S+) to (\S+) "): lambda: span(
        "link_masses", "factor"
    ),
    ("concepts/randomisation.md", r"each joint's control \| x (\S+) to (\S+) "): lambda: span("gains", "stiffness"),
    ("concepts/randomisation.md", r"with its limit \| x (\S+) to (\S+) "): lambda: span("strength", "strength"),
    ("concepts/randomisation.md", r"viscous friction \| x (\S+) to (\S+), (\S+) to (\S+) Nm s/rad"): lambda: (
        *span("armature", "factor"),
        *span("joint_damping", "damping"),
    ),
    ("concepts/randomisation.md", r"each encoder \| ±(\S+) rad"): lambda: (one("encoders", "bias"),),
    ("concepts/randomisation.md", r"gyroscope \| ±(\S+) rad, ±(\S+) rad/s"): lambda: (
        one("imu_mounting", "tilt"),
        one("gyro_bias", "bias"),
    ),
    ("concepts/randomisation.md", r"time constant of contacts \| (\S+) to (\S+) ms"): lambda: ms(
        "contact_softness", "time_constant"
    ),
    ("concepts/randomisation.md", r"to the motors \| (\S+) to (\S+) ms"): lambda: ms("control_delay", "delay"),
    ("concepts/randomisation.md", r"what the policy sees \| (\S+) to (\S+) ms"): lambda: ms("observation_age", "age"),
    ("concepts/randomisation.md", r"(\S+) to (\S+), at least what the tile needs plus (\S+) "): lambda: (
        *span("friction", "friction"),
        one("friction", "slope_margin"),
    ),
    ("concepts/randomisation.md", r"a kick every (\d) to (\d) s \| up to (\S+) m/s along"): lambda: (
        *(f"{seconds:g}" for seconds in randomisation().push.interval_s),
        one("push", "speed"),
    ),
    ("guides/laptop.md", r"preset: (\d+) robots, physics of (\d+) ms x (\d) .*? networks of (\d+), (\d+) and (\d+)"): (
        lambda: preset("cpu")
    ),
    ("guides/gpus.md", r"preset: (\d+) robots, physics of (\d+) ms x (\d) .*? networks of (\d+), (\d+) and (\d+)"): (
        lambda: preset("gpu")
    ),
}


@pytest.mark.parametrize(("page", "claim"), CLAIMS)
def test_a_number_of_a_page_is_that_of_the_code(page: str, claim: str) -> None:
    found = re.search(claim, text(page))
    assert found is not None, "the sentence is gone or rephrased: change its claim here too"
    assert found.groups() == tuple(CLAIMS[page, claim]())


def test_claims_in_words_hold() -> None:
    # "an upward force of half the body weight"
    assert randomisation().harness.params["support"] == 0.5
    # "prices for restless motion begin to count" as the harness goes
    assert {"action_acc", "landings"} <= set(STRICT)
    # "The regulariser is used in Stage I alone"
    assert "zmp" not in stage2().env.rewards
    # "over five control steps"
    assert stage1().env.observations.actor.history == 5
