"""The baselines have Unitree RL Lab's recipe on Stage I's worlds, and train by the same command line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from humoslope.cli import main
from humoslope.env import ManagerBasedRlEnv
from humoslope.learning import checkpoint
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import TaskCfg, build_task
from robots.unitree_g1 import UNITREE_G1

LITERAL, RELATIVE = "URL-Literal-Unitree-G1", "URL-TerrainRelative-Unitree-G1"


def standing(task: str, x: float, ground: float, root_height: float = 0.78) -> ManagerBasedRlEnv:
    """The task with its robots upright over ground that is `ground` m high everywhere, as the terms see it."""
    cfg = build_task(task).env
    cfg.num_envs, cfg.sim.backend = 2, "native"
    env = ManagerBasedRlEnv(cfg)
    signals = env.signals
    signals.root_pos_w = torch.tensor([[x, 0.0, ground + root_height]]).repeat(2, 1)
    signals.root_height = torch.full((2,), root_height)
    signals.foot_pos_w = torch.tensor([x, 0.0, ground + 0.065]).expand(2, 2, 3)
    signals.foot_height = torch.full((2, 2), 0.065)
    signals.foot_lin_vel_w = torch.tensor([0.5, 0.0, 0.0]).expand(2, 2, 3)
    return env


def earned(env: ManagerBasedRlEnv, name: str) -> float:
    env.rewards.compute(env.step_dt)
    return env.rewards.last[0, env.rewards.names.index(name)].item()


@pytest.mark.parametrize("task", [LITERAL, RELATIVE])
def test_actor_and_critic_see_what_unitrees_do(task: str) -> None:
    cfg = build_task(task)
    cfg.env.num_envs, cfg.env.sim.backend = 2, "native"
    groups = ManagerBasedRlEnv(cfg.env).observations.groups
    assert {name: group.shape for name, group in groups.items()} == {"actor": (480,), "critic": (495,)}
    assert next(iter(groups["critic"].term_shapes)) == "base_lin_vel"
    assert not groups["critic"].cfg.enable_corruption


def test_ppo_is_unitrees() -> None:
    agent = build_task(LITERAL).agent
    told = agent.to_rsl_rl()
    assert agent.hidden_dims == (512, 256, 128)
    assert told["actor"]["distribution_cfg"]["init_std"] == 1.0
    assert not told["actor"]["obs_normalization"]
    assert not agent.symmetry
    expected = {
        "num_learning_epochs": 5,
        "num_mini_batches": 4,
        "learning_rate": 1e-3,
        "desired_kl": 0.01,
        "gamma": 0.99,
        "lam": 0.95,
        "clip_param": 0.2,
        "entropy_coef": 0.01,
        "value_loss_coef": 1.0,
        "max_grad_norm": 1.0,
    }
    assert {name: told["algorithm"][name] for name in expected} == expected


def test_robot_ground_commands_randomisation_and_harness_are_those_of_stage_1() -> None:
    own, ours = plain(build_task(LITERAL)), plain(build_task("HumoSlope-Stage1-Unitree-G1"))
    for same in ("actions", "sim", "command", "events", "episode_length_s"):
        assert own["env"][same] == ours["env"][same]
    for same in ("harness", "skills", "terrain_levels"):
        assert own["env"]["curriculum"][same] == ours["env"]["curriculum"][same]
    assert own["env"]["scene"] == ours["env"]["scene"]
    assert own["env"]["observations"]["actor"] == ours["env"]["observations"]["actor"]


def test_the_two_differ_in_heights_alone() -> None:
    literal, relative = (plain(build_task(task)) for task in (LITERAL, RELATIVE))
    changed = {
        name
        for name in literal["env"]["rewards"]
        if literal["env"]["rewards"][name] != relative["env"]["rewards"][name]
    }
    assert changed == {"root_height", "foot_clearance"}
    ends = literal["env"]["terminations"], relative["env"]["terminations"]
    assert {name for name in ends[0] if ends[0][name] != ends[1][name]} == {"root_too_low"}
    for there in (literal, relative):
        del there["env"]["rewards"], there["env"]["terminations"]
    assert literal == relative


def test_a_metre_up_the_literal_reward_costs_ten_a_second_and_the_relative_one_nothing() -> None:
    literal, relative = (standing(task, x=0.0, ground=1.0) for task in (LITERAL, RELATIVE))
    assert earned(literal, "root_height") == pytest.approx(-10.0, abs=1e-3)
    assert earned(relative, "root_height") == pytest.approx(0.0, abs=1e-6)
    # Both feet are a metre above the height they should have.
    assert earned(literal, "foot_clearance") == pytest.approx(math.exp(-2.0 * math.tanh(1.0) / 0.05), abs=1e-6)
    assert earned(relative, "foot_clearance") == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("task", "fails"), [(LITERAL, True), (RELATIVE, False)])
def test_a_metre_down_only_the_literal_one_takes_the_robot_for_fallen(task: str, fails: bool) -> None:
    env = standing(task, x=0.0, ground=-1.0)
    env.terminations.compute()
    assert env.terminations.terminated.tolist() == [fails, fails]


@pytest.mark.parametrize(("degrees", "fails"), [(45.0, False), (46.5, True)])
def test_a_lean_of_0_8_rad_is_a_fall(degrees: float, fails: bool) -> None:
    env = standing(RELATIVE, x=0.0, ground=0.0)
    lean = math.radians(degrees)
    env.signals.projected_gravity_b = torch.tensor([[math.sin(lean), 0.0, -math.cos(lean)]]).repeat(2, 1)
    env.terminations.compute()
    assert env.terminations.terminated.tolist() == [fails, fails]


def test_the_sole_is_asked_for_where_the_ankle_would_be_a_tenth_of_a_metre_high() -> None:
    model = UNITREE_G1.make_spec().compile()
    sole = model.site("left_foot").pos[2]
    assert build_task(LITERAL).env.rewards.foot_clearance.params["target"] == pytest.approx(0.1 + sole)


@pytest.mark.parametrize("task", [LITERAL, RELATIVE])
def test_the_cpu_preset_changes_its_scale_alone(task: str) -> None:
    def recipe(cfg: TaskCfg) -> object:
        told = plain(cfg)["env"]
        return [told[name] for name in ("rewards", "observations", "terminations", "events", "command", "curriculum")]

    cfg = build_task(task)
    apply_preset(cfg, "cpu")
    assert recipe(cfg) == recipe(build_task(task))
    assert cfg.agent.num_learning_epochs == 2


@pytest.mark.parametrize("task", [LITERAL, RELATIVE])
def test_it_trains_by_the_command_line(task: str, tmp_path: Path) -> None:
    tiny = [
        *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu"),
        *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
        *("--agent.num-steps-per-env", "4", "--agent.num-mini-batches", "2", "--agent.hidden-dims", "16", "16"),
        *("--agent.max-iterations", "1", "--agent.no-mixed-precision"),
    ]
    assert main(["train", task, "--run-dir", str(tmp_path / "run"), *tiny]) == 0
    state = checkpoint.load(tmp_path / "run" / "model_0.pt", task)
    assert state["total_steps"] == 32
    assert all(value.isfinite().all() for value in state["policy"]["weights"].values())
