"""The training harness: an assistive wrench that carries and uprights the robot, and the curriculum that withdraws it.

With it a policy meets walking before it has learnt to stand; without it, on few samples, it only ever stands still.
It exists in training alone: no evaluation configures it, and a run that used it logs its strength.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import mujoco
import torch
from torch import Tensor

from humoslope.errors import UserError, require_not_negative, require_positive, unknown
from humoslope.managers.command import MODES, SKILLS, commanded_and_walked
from humoslope.managers.curriculum import CurriculumTerm
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.rewards import yaw_rate
from humoslope.mdp.standing import both_feet_down
from humoslope.ranges import NotNegative, Positive, Share
from humoslope.slope import quaternion, zmp

if TYPE_CHECKING:
    from collections.abc import Callable

    from humoslope.env import ManagerBasedRlEnv as Env


class Harness(StatefulTerm):
    """Step event: an upward force on the root and an uprighting torque on the torso, scaled by `scale` in [0, 1].

    It acts from the start of an episode: a reset sets it for the state that the reset events have written.

    Attributes:
        scale: Present strength, in [0, 1].
        skill_scales: [4] strength in envs that are commanded to do each of `SKILLS` but forward, in [0, 1]; None for
            `scale` in all.
        strictness: How much is asked for beyond walking, in [0, 1]; it grows when the harness is gone.

    Args:
        support: Upward force at full scale, as a share of body weight.
        stiffness: Torque about the horizontal axes per sine of the torso's lean, Nm.
        damping: Torque against the torso's horizontal angular velocity, Nm s/rad.
        scale: Initial scale.
    """

    START_ONLY = ("scale",)

    def __init__(
        self,
        env: Env,
        support: NotNegative = 0.35,
        stiffness: NotNegative = 120.0,
        damping: NotNegative = 3.0,
        scale: Share = 1.0,
    ) -> None:
        if not 0.0 <= scale <= 1.0:
            raise UserError(f"harness: scale {scale} must be between 0 and 1.")
        require_not_negative("harness", support=support, stiffness=stiffness, damping=damping)
        self.scale = torch.tensor(scale, device=env.device)
        self.skill_scales: Tensor | None = None
        self.strictness = torch.zeros((), device=env.device)
        self._env = env
        self._lift = support * env.robot.total_mass * zmp.GRAVITY  # N
        self._stiffness, self._damping = stiffness, damping
        self._bodies = env.body_id(env.robot.root_body), env.body_id(env.robot.torso_body)
        self._wrench = env.sim.state("xfrc_applied")  # [N, bodies, 6]: force, torque; world frame
        self._up = torch.tensor([[0.0, 0.0, 1.0]], device=env.device)
        self._chain = _Chain(env.sim.model, *self._bodies, env.device)

    @classmethod
    def of(cls, env: Env, event: str) -> Harness:
        """The event of this name.

        Raises:
            UserError: If it is no harness.
        """
        harness = env.events[event]
        if not isinstance(harness, cls):
            raise UserError(f"event '{event}' is not a Harness.")
        return harness

    def held_by_scale(self, env: Env) -> Tensor:
        """Mask [N] of the envs that `scale` holds."""
        if self.skill_scales is None:
            return torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        forward: Tensor = env.commands.skill == SKILLS.index("forward")
        return forward

    @property
    def withdrawn(self) -> Tensor:
        """What has been withdrawn of it, a scalar in [0, 1]."""
        return 1.0 - self.scale

    def __call__(self, env: Env, mask: Tensor) -> None:
        signals, scale = env.signals, self.scale
        if self.skill_scales is not None:
            scale = torch.cat([scale[None], self.skill_scales])[env.commands.skill, None]  # [N, 1]
        torso_up_w = quaternion.matrix(signals.torso_quat_w)[:, :, 2]
        self._write(self._wrench, torso_up_w, signals.torso_ang_vel_w, scale)

    def reset(self, mask: Tensor) -> None:
        """Writes the wrench for the start of an episode into `env.start_wrench`."""
        scale = self.scale
        if self.skill_scales is not None:  # commands are drawn after the start
            scale = torch.maximum(scale, self.skill_scales.max())
        torso_up_w, ang_vel_w = self._chain(self._env.start_qpos, self._env.start_qvel)
        self._write(self._env.start_wrench, torso_up_w, ang_vel_w, scale)

    def _write(self, wrench: Tensor, torso_up_w: Tensor, torso_ang_vel_w: Tensor, scale: Tensor) -> None:
        """Writes the wrenches on root and torso, by `scale` (a scalar or [N, 1]), into `wrench` [N, bodies, 6]."""
        root, torso = self._bodies
        uprighting = self._stiffness * torch.linalg.cross(torso_up_w, self._up)
        torque = torch.sub(uprighting, torso_ang_vel_w, alpha=self._damping)
        wrench[:, root, 2:3].copy_(self._lift * scale)
        wrench[:, torso, 3:5].copy_(torque[:, :2] * scale)


class _Chain:
    """Forward kinematics from a floating root to one body, through hinges.

    What the physics will only know after the reset, for which the wrench is needed before it.
    """

    def __init__(self, model: mujoco.MjModel, root: int, body: int, device: torch.device) -> None:
        self._links: list[tuple[Tensor, list[tuple[Tensor, Tensor, int, int, float]]]] = []
        while body != root:
            hinges = []
            first, count = model.body_jntadr[body], model.body_jntnum[body]
            for joint in range(first, first + count):
                if body == 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                    raise UserError("harness: only hinge joints may connect the robot's root with its torso.")
                axis = torch.tensor(model.jnt_axis[joint], dtype=torch.float32, device=device)
                cross = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, device=device)).T  # cross @ v = axis x v
                position, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
                hinges.append((axis, cross, position, velocity, float(model.qpos0[position])))
            frame = torch.tensor(model.body_quat[body], dtype=torch.float32, device=device)
            self._links.insert(0, (quaternion.matrix(frame), hinges))
            body = int(model.body_parentid[body])
        self._eye = torch.eye(3, device=device)

    def __call__(self, qpos: Tensor, qvel: Tensor) -> tuple[Tensor, Tensor]:
        """Up axis and angular velocity of the body in the world frame, [N, 3] each, from `qpos` and `qvel`."""
        rotation = quaternion.matrix(qpos[:, 3:7])  # [N, 3, 3]
        ang_vel = (rotation @ qvel[:, 3:6, None]).squeeze(2)  # MuJoCo has a free joint's in the body frame
        for frame, hinges in self._links:
            rotation = rotation @ frame
            for axis, cross, position, velocity, at_rest in hinges:
                ang_vel = ang_vel + (rotation @ axis) * qvel[:, velocity, None]
                angle = qpos[:, position, None, None] - at_rest
                turn = self._eye + angle.sin() * cross + (1.0 - angle.cos()) * (cross @ cross)  # Rodrigues
                rotation = rotation @ turn
        return rotation[:, :, 2], ang_vel


class HarnessCurriculum(CurriculumTerm):
    """Curriculum: the harness is withdrawn while the robots hardly fall and really walk; then more is asked of them.
    With a `SkillCurriculum`, robots are those that are commanded to walk ahead.

    First things first: a robot that has to climb, to bear pushes and to step rarely while its support goes, falls ever
    more often, and keeps the rest of its support.

    Args:
        event: Name of the `Harness` event.
        rate: Scale withdrawn per second of training time in one env. 0.0083 is 0.004 in a rollout of 24 steps of 20 ms.
        strict_rate: Strictness added per second. Lower, since what is asked for with it takes longer to learn.
        falls_per_second: Falls per env and second from which the harness is left as it is.
        falls_unaided: Falls per env and second from which strictness is left as it is. Higher, since steep ground,
            pushes and turns fell robots that are learning well, and what is not asked of them they never learn.
        speed_share: Share of the commanded speed, in whatever direction, up to which both are left as they are:
            standing still is no skill.
        memory_s: Time over which both are averaged, s.
    """

    def __init__(
        self,
        env: Env,
        event: str = "harness",
        rate: NotNegative = 0.0083,
        strict_rate: NotNegative = 0.005,
        falls_per_second: NotNegative = 0.08,
        falls_unaided: NotNegative = 0.1,
        speed_share: NotNegative = 0.7,
        memory_s: Positive = 10.0,
    ) -> None:
        harness = Harness.of(env, event)
        require_not_negative(
            "harness curriculum",
            rate=rate,
            strict_rate=strict_rate,
            falls_per_second=falls_per_second,
            falls_unaided=falls_unaided,
        )
        require_positive("harness curriculum", memory_s=memory_s)
        self._harness, self._rate, self._strict_rate = harness, rate, strict_rate
        self._most_falls, self._most_falls_unaided = falls_per_second, falls_unaided
        self._least_speed = speed_share
        self._keep = max(0.0, 1.0 - env.step_dt / memory_s)
        # Starts as if every robot fell and none walked: nothing is withdrawn before they have proven themselves.
        self._falls = torch.ones((), device=env.device)  # per second
        self._speed = torch.zeros((), device=env.device)  # share of the commanded one

    @property
    def scale(self) -> Tensor:
        """Present scale of the harness."""
        return self._harness.scale

    def step(self, env: Env) -> Tensor:
        """Withdraws a little where it is deserved; returns the scale."""
        held = self._harness.held_by_scale(env).float()
        falls = (env.terminations.terminated * held).sum() / (held.sum().clamp(min=1.0) * env.step_dt)
        commanded, walked = ((speed * held).sum() for speed in commanded_and_walked(env))
        # Where no robot is commanded to walk, nothing is learnt about it.
        share = torch.where(commanded > 0.0, walked / commanded, self._speed)
        self._falls = torch.lerp(falls, self._falls, self._keep)
        self._speed = torch.lerp(share, self._speed, self._keep)
        harness = self._harness
        walking, unaided = self._speed > self._least_speed, harness.scale <= 0.0
        stricter = unaided & walking & (self._falls < self._most_falls_unaided)
        looser = walking & (self._falls < self._most_falls)
        harness.strictness = (harness.strictness + self._strict_rate * env.step_dt * stricter).clamp(max=1.0)
        harness.scale = (harness.scale - self._rate * env.step_dt * looser).clamp(min=0.0)
        return harness.scale

    def state_dict(self) -> dict[str, Any]:
        """Scale, strictness, fall rate and speed."""
        harness = self._harness
        return {
            "scale": harness.scale.item(),
            "strictness": harness.strictness.item(),
            "falls": self._falls.item(),
            "speed": self._speed.item(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the result of `state_dict`."""
        self._harness.scale = torch.tensor(state["scale"], device=self._falls.device)
        self._harness.strictness = torch.tensor(state.get("strictness", 0.0), device=self._falls.device)
        self._falls = torch.tensor(state["falls"], device=self._falls.device)
        self._speed = torch.tensor(state["speed"], device=self._speed.device)

    def average(self, mean: Callable[[Tensor], Tensor]) -> None:
        """Withdraws the harness of all processes alike, by their mean fall rate and speed."""
        self._falls, self._speed = mean(self._falls), mean(self._speed)
        self._harness.scale, self._harness.strictness = mean(self._harness.scale), mean(self._harness.strictness)


class SkillCurriculum(CurriculumTerm):
    """Curriculum: robots learn to walk backward, to a side, to turn and to stand, each in a harness of its own.

    First the commands change, and then the harness goes, while the robots that have such a command hardly fall and do
    what they are asked. Commands to walk turn away from ahead little by little, and back where they are not followed: a
    robot that only knows how to walk forward earns next to nothing for a command to walk backward, whatever it does
    about it, and stands still. One that falls when it walks backward soon stands still as well. Commands to stand come
    last, with the second half of that turn: whoever learns to stand before it walks in every direction, stands instead.
    And a robot that walks unaided and is commanded to stand, but cannot, marches on the spot: it does not fall, and
    never learns it.

    Attributes:
        scales: [4] present scale of the harness for each of `SKILLS` but forward.

    Args:
        event: Name of the `Harness` event.
        rate: Variety of commands (`CommandManager.variety`) added, and scale withdrawn, per second of training time in
            one env.
        falls_per_second: Falls per env and second, of the envs with such a command, from which both are left as they
            are.
        share: Share of what is commanded up to which both are left as they are: of the speed, of the yaw rate, or of
            the time to stand with both feet on the ground.
        lost_share: Share below which variety is taken back at the same rate.
        memory_s: Time over which falls and share are averaged, s.
    """

    def __init__(
        self,
        env: Env,
        event: str = "harness",
        rate: NotNegative = 0.0083,
        falls_per_second: NotNegative = 0.1,
        share: Share = 0.5,
        lost_share: Share = 0.4,
        memory_s: Positive = 10.0,
    ) -> None:
        self._harness, self._rate = Harness.of(env, event), rate
        self._most_falls, self._least_share, self._lost_share = falls_per_second, share, lost_share
        self._keep = max(0.0, 1.0 - env.step_dt / memory_s)
        self._places = torch.arange(1, len(SKILLS), device=env.device)
        command = env.cfg.command
        asked = [*(command.asks_for(mode) for mode in MODES[1:]), command.standing_share > 0.0]
        self._asked = torch.tensor(asked, device=env.device)
        # Starts as if every robot fell and none could do it: nothing is withdrawn before they have proven themselves.
        self._falls = torch.ones(len(asked), device=env.device)  # per second
        self._share = torch.zeros(len(asked), device=env.device)
        self._variety = (~self._asked).float()  # what is never asked counts as learnt
        self._set(self._harness.scale * self._asked)

    def begin(self, env: Env) -> None:
        """Sets the variety of the first commands."""
        env.commands.variety = self._variety

    def step(self, env: Env) -> Tensor:
        """Asks for more, or withdraws a little, where it is deserved; returns how far all skills have come: 1 when they
        are done unaided."""
        asked, done = _asked_and_done(env)
        each = torch.stack([torch.ones_like(asked), asked, done, env.terminations.terminated.to(asked.dtype)])  # [4, N]
        of_skill = (env.commands.skill[:, None] == self._places).to(each.dtype)  # [N, 4]
        count, asked, done, fell = each @ of_skill  # [4] each
        # Where nobody is commanded to do it, nothing is learnt about it.
        there = (count > 0.0) & (asked > 0.0)
        falls = torch.where(there, fell / (count * env.step_dt), self._falls)
        share = torch.where(there, done / asked, self._share)
        self._falls = torch.lerp(falls, self._falls, self._keep)
        self._share = torch.lerp(share, self._share, self._keep)
        deserved = there & (self._falls < self._most_falls) & (self._share > self._least_share)
        ready = deserved & (self._variety >= 1.0)
        self._set((self.scales - self._rate * env.step_dt * ready).clamp(min=0.0))
        lost = there & (self._share < self._lost_share)
        change = self._rate * env.step_dt * (deserved.float() - lost.float())
        walks = (self._variety + change)[:-1].clamp(0.0, 1.0)
        stands = (2.0 * walks.mean() - 1.0).clamp(min=0.0)
        self._variety = torch.cat([walks, stands[None]])
        self.begin(env)
        for i, skill in enumerate(SKILLS[1:]):
            env.log.add(f"Skill/{skill}", self._share[i])
            env.log.add(f"Variety/{skill}", self._variety[i])
            env.log.add(f"Harness/{skill}", self.scales[i])
        return (0.5 * (self._variety + 1.0 - self.scales) * self._asked).sum() / self._asked.sum().clamp(min=1)

    def _set(self, scales: Tensor) -> None:
        self.scales = self._harness.skill_scales = scales

    def state_dict(self) -> dict[str, Any]:
        """Scales, variety, fall rates and shares."""
        tensors = {"scale": self.scales, "variety": self._variety, "falls": self._falls, "share": self._share}
        return {name: value.tolist() for name, value in tensors.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the result of `state_dict`."""
        restored = {name: torch.tensor(value, device=self._falls.device) for name, value in state.items()}
        self._set(restored["scale"])
        self._variety, self._falls, self._share = (restored[name] for name in ("variety", "falls", "share"))

    def average(self, mean: Callable[[Tensor], Tensor]) -> None:
        """Asks for as much, and withdraws as much, in all processes, by their means."""
        self._variety, self._falls, self._share = mean(self._variety), mean(self._falls), mean(self._share)
        self._set(mean(self.scales))


def _asked_and_done(env: Env) -> tuple[Tensor, Tensor]:
    """How much each env is commanded to do, and how much of it is done; [N] each, in the unit of its command: speed in
    m/s, yaw rate in rad/s, or 1 for standing with both feet on the ground."""
    skill, turn = env.commands.skill, env.commands.velocity[:, 2]
    turns, stands = skill == SKILLS.index("turning"), skill == SKILLS.index("standing")
    asked, done = commanded_and_walked(env)
    asked = torch.where(turns, turn.abs(), asked).masked_fill(stands, 1.0)
    done = torch.where(turns, yaw_rate(env) * turn.sign(), done)
    return asked, torch.where(stands, both_feet_down(env), done)


class StrengthenRewards(CurriculumTerm):
    """Curriculum: some rewards count by how far the training has come.

    Prices of steps and of restless actions belong here: paid from the start, they would make standing still the best
    that a robot can do before it has learnt to walk.

    Args:
        rewards: Names of the rewards.
        by: What they grow with: what has been "withdrawn" of the harness, or the "strictness" that follows; see
            `HarnessCurriculum`.
        event: Name of the `Harness` event.
    """

    def __init__(
        self,
        env: Env,
        rewards: tuple[str, ...],
        by: Literal["withdrawn", "strictness"] = "strictness",
        event: str = "harness",
    ) -> None:
        for name in rewards:
            if name not in env.cfg.rewards:
                raise unknown("reward", name, env.cfg.rewards)
        self._rewards = tuple(name for name in rewards if env.cfg.rewards[name].weight)  # others are switched off
        self._harness, self._by = Harness.of(env, event), by

    def step(self, env: Env) -> Tensor:
        """Sets the strengths; returns it."""
        strength: Tensor = getattr(self._harness, self._by)
        for name in self._rewards:
            env.rewards.set_strength(name, strength)
        return strength
