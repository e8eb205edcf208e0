"""Position controllers and motors of the joints, which may differ between envs."""

from __future__ import annotations

import torch
from torch import Tensor

from humoslope.scene.robot import Robot
from humoslope.sim.fields import replace
from humoslope.sim.protocol import Simulation


class Drives:
    """Parameters of the joint drives of each env, and the actuator fields of the model that follow from them.

    The torque is `strength * clamp(kp (target - measured) - kd velocity, +-effort_limit)`, where the controller
    measures the joint position plus `encoder_bias`. One place holds all, since several events change the same fields.

    Attributes:
        stiffness: [N, J] position gains kp, Nm/rad.
        damping: [N, J] velocity gains kd, Nm s/rad.
        strength: [N, J] factors on the torque, its limit included.
        encoder_bias: [N, J] measured less true joint positions, rad.
        nominal_stiffness, nominal_damping: [J] gains of the robot.
        nominal_armature: [J] reflected motor inertia of the model, kg m^2.
    """

    def __init__(self, sim: Simulation, robot: Robot) -> None:
        def per_joint(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=sim.device)

        self._sim = sim
        self.nominal_stiffness, self.nominal_damping = per_joint(robot.stiffness), per_joint(robot.damping)
        self.nominal_armature = per_joint(sim.model.dof_armature[-robot.num_joints :])
        self._limit = per_joint(robot.effort_limit)[:, None] * per_joint([-1.0, 1.0])  # [J, 2] Nm
        self.stiffness = self.nominal_stiffness.repeat(sim.num_worlds, 1)
        self.damping = self.nominal_damping.repeat(sim.num_worlds, 1)
        self.strength = torch.ones_like(self.stiffness)
        self.encoder_bias = torch.zeros_like(self.stiffness)

    def set(
        self,
        mask: Tensor,
        *,
        stiffness: Tensor | None = None,
        damping: Tensor | None = None,
        strength: Tensor | None = None,
        encoder_bias: Tensor | None = None,
    ) -> None:
        """Changes parameters [N, J] in the envs in `mask` [N]; the others keep theirs."""
        chosen = mask[:, None]
        if stiffness is not None:
            self.stiffness = torch.where(chosen, stiffness, self.stiffness)
        if damping is not None:
            self.damping = torch.where(chosen, damping, self.damping)
        if encoder_bias is not None:
            self.encoder_bias = torch.where(chosen, encoder_bias, self.encoder_bias)
        if strength is not None:
            self.strength = torch.where(chosen, strength, self.strength)
            force_range = self._sim.expand("actuator_forcerange")  # [N, J, 2]
            replace(force_range, mask, self.strength[:, :, None] * self._limit)
        # A MuJoCo position actuator: force = gain ctrl + bias0 + bias1 q + bias2 dq.
        kp, kd = self.strength * self.stiffness, self.strength * self.damping
        bias = self._sim.expand("actuator_biasprm")  # [N, J, 10]
        replace(self._sim.expand("actuator_gainprm")[:, :, 0], mask, kp)
        replace(bias[:, :, :3], mask, torch.stack([-kp * self.encoder_bias, -kp, -kd], dim=2))
