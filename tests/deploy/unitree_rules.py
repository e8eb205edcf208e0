"""Unitree RL Lab's C++ rules for a deploy.yaml, written down anew.

The rules (deploy/include/isaaclab of unitree_rl_lab): observations in the order of the file; each is computed by the
function of its name, clipped, scaled and kept for `history_length` steps, the oldest first; a reset fills the history
with the present value, and each step adds one. With `scale_first` it is scaled, then clipped; with `use_gym_history`
the observations of one step stand together. Joint i is motor `joint_ids_map[i]`. A target is scale times action plus
offset. Gains are set motor by motor, in the order of the motors. Sticks are clamped to the ranges of the command.
Everything is in single precision.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import yaml

F = np.float32


class Motors:
    """A LowState: quaternion, gyroscope, and each motor in the order of the SDK; and the remote's sticks."""

    def __init__(self, rng: np.random.Generator) -> None:
        quat = rng.normal(size=4)
        self.quat, self.gyro = (quat / np.linalg.norm(quat)).astype(F), rng.normal(size=3).astype(F)
        self.q, self.dq = rng.normal(size=29).astype(F), rng.normal(size=29).astype(F)
        self.ly, self.lx, self.rx = rng.uniform(-1.0, 1.0, 3).astype(F)


class TheirDeployment:
    """What the C++ program does with a folder."""

    def __init__(self, folder: Path) -> None:
        self.cfg: dict[str, Any] = yaml.safe_load((folder / "params" / "deploy.yaml").read_text())
        self._terms = [name for name in self.cfg["observations"] if name not in ("use_gym_history", "scale_first")]
        self._network = ort.InferenceSession(folder / "exported" / "policy.onnx", providers=["CPUExecutionProvider"])
        self._action = np.zeros(29, dtype=F)
        self._history: dict[str, deque[Any]] = {}

    def reset(self, motors: Motors) -> None:
        self._action[:] = 0.0
        for name in self._terms:
            length = self.cfg["observations"][name]["history_length"]
            self._history[name] = deque([self._term(name, motors)] * length, maxlen=length)

    def step(self, motors: Motors) -> dict[str, Any]:
        """Commands [29] in the order of the motors."""
        for name in self._terms:
            self._history[name].append(self._term(name, motors))
        frames = [list(self._history[name]) for name in self._terms]
        if self.cfg["observations"].get("use_gym_history"):
            frames = list(zip(*frames, strict=True))
        observation = [part for several in frames for part in several]
        (output,) = self._network.run(["actions"], {"obs": np.concatenate(observation)[None]})
        self._action = output[0]
        action, ids = self.cfg["actions"]["JointPositionAction"], self.cfg["joint_ids_map"]
        targets = self._action * F(action["scale"]) + F(action["offset"])
        q = np.zeros(29, dtype=F)
        q[ids] = targets
        return {"q": q, "kp": F(self.cfg["stiffness"]), "kd": F(self.cfg["damping"])}

    def _term(self, name: str, motors: Motors) -> Any:
        term, ids = self.cfg["observations"][name], self.cfg["joint_ids_map"]
        w, x, y, z = motors.quat
        ranges = self.cfg["commands"]["base_velocity"]["ranges"]
        sticks = {"lin_vel_x": motors.ly, "lin_vel_y": -motors.lx, "ang_vel_z": -motors.rx}
        raw = {
            "base_ang_vel": lambda: motors.gyro,
            # The rotation of (0, 0, -1) by the conjugate.
            "projected_gravity": lambda: F([2 * (w * y - x * z), -2 * (y * z + w * x), 2 * (x * x + y * y) - 1]),
            "velocity_commands": lambda: F([np.clip(stick, *ranges[axis]) for axis, stick in sticks.items()]),
            "joint_pos_rel": lambda: motors.q[ids] - F(self.cfg["default_joint_pos"]),
            "joint_vel_rel": lambda: motors.dq[ids],
            "last_action": lambda: self._action,
        }[name]()
        scale_first = self.cfg["observations"].get("scale_first")
        if scale_first:
            raw = raw * F(term["scale"])
        if term["clip"] is not None:
            raw = np.clip(raw, *term["clip"])
        return np.asarray(raw if scale_first else raw * F(term["scale"]), dtype=F)
