"""Time series of a rollout."""

from __future__ import annotations

import numpy as np

from humoslope.replay.rerun import colours
from humoslope.replay.rerun.scene import Scene
from humoslope.replay.rollout import Rollout

BUSIEST = 10
"""Number of joints whose load is plotted, the most loaded first."""


def log_plots(scene: Scene, rollout: Rollout, shared: str = "", pale: bool = False) -> None:
    """Writes every series.

    Args:
        scene: Scene of the rollout, which writes into the recording.
        rollout: The rollout.
        shared: Prefix of the names in plots that two rollouts share.
        pale: Draw lighter lines in these plots, for the second of two.
    """
    c = rollout.columns

    def series(path: str, lines: dict[str, np.ndarray], palette: list[colours.Colour], own: bool = False) -> None:
        chosen = [colours.paler(colour) if pale and not own else colour for colour in palette]
        names = list(lines) if own else [f"{shared}{name}" for name in lines]
        scene.series(f"plots/{path}", np.stack(list(lines.values()), axis=1), names, chosen)

    deviation = np.linalg.norm(c.zmp_w - c.zmp_anchor_w, axis=1)
    series(
        "speed",
        {"commanded": c.command[:, 0], "actual": c.root_lin_vel_t[:, 0]},
        [colours.COMMANDED, colours.ACTUAL],
    )
    height = {"CoM": c.com_height, "target": c.com_height_target, "root": c.root_height}
    if not np.isfinite(c.com_height_target).any():
        del height["target"]
    series("height", height, [colours.COM, colours.TARGET, colours.SUPPORT])
    series("zmp", {"ZMP to anchor": np.where(c.zmp_valid, deviation, np.nan)}, [colours.ZMP])
    ground = {"slope": np.degrees(c.slope), "bank": np.degrees(c.bank)}
    series("ground", ground, [colours.NORMAL, colours.TARGET])
    force = np.linalg.norm(c.foot_force_w, axis=2)
    forces, hues = {"left": force[:, 0], "right": force[:, 1]}, [colours.COMMANDED, colours.FORCE]
    if np.isfinite(c.self_force).any():
        forces["robot on itself"] = c.self_force
        hues.append(colours.ZMP)
    series("force", forces, hues, own=True)

    share = np.abs(c.joint_torque) / np.array(rollout.header["robot"]["effort_limit"], np.float32)
    busiest = np.argsort(-np.square(share).mean(axis=0))[:BUSIEST]
    names = [rollout.joint_names[i].removesuffix("_joint").replace("_", " ") for i in busiest]
    loads = {name: 100.0 * share[:, i] for name, i in zip(names, busiest, strict=True)}
    series("load", loads, colours.palette(len(loads)), own=True)
    terms = rollout.header["reward_terms"]
    if terms:  # the log of a robot has none
        rewards = {name.replace("_", " "): c.reward[:, i] for i, name in enumerate(terms)}
        series("reward", rewards, colours.palette(len(terms)), own=True)
