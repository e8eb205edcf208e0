"""Draws a policy walking up a ramp, as one picture with the robot at several instants. The README's picture is made by

.venv/bin/python experiments/picture.py experiments/checkpoints/stage1.pt experiments/figures/stage1_ramp.png \
        --grade 30
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is imported: rendering without a display

import matplotlib.image
import mujoco
import numpy as np
import torch
import tyro

from humoslope.env import ManagerBasedRlEnv
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.registry import build_task, load_content
from humoslope.rl.policy import load_actor, read_provenance
from humoslope.terrain import add_terrain


def picture(checkpoint: Path, out: Path, /, grade: float = 20.0, instants: int = 6, every_s: float = 1.6) -> None:
    """Draws the walk of `checkpoint` on a ramp of `grade` degrees to a PNG.

    Args:
        checkpoint: Of any task.
        out: Where to write.
        grade: Degrees, negative down.
        instants: How often the robot is drawn.
        every_s: Time between two instants, s.
    """
    load_content()
    protocol = RampProtocol(grades=(grade,), starts=1)
    env = ManagerBasedRlEnv(ramp_env_cfg(build_task(read_provenance(checkpoint).task).env, protocol))
    policy = load_actor(checkpoint, env)
    poses, qpos = [], env.sim.state("qpos")
    with torch.inference_mode():
        for step in range(round(instants * every_s / env.step_dt)):
            env.step(policy(env.get_observations()))
            if (step + 1) % round(every_s / env.step_dt) == 0:
                poses.append(qpos[0].clone().numpy())
    image = render(env, np.array(poses))
    out.parent.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(out, image)
    print(f"wrote {out}")


def render(env: ManagerBasedRlEnv, poses: np.ndarray) -> np.ndarray:
    """An image [height, width, 3] of the robot in all `poses` [K, nq] at once, seen from the side."""
    spec = env.robot.make_spec()  # the first of them; the others are attached to it
    add_terrain(spec, env.cfg.scene.terrain.build())
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1600, 700
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=[0.4, 0.6, -1.0], diffuse=[0.6] * 3)
    for i in range(1, len(poses)):
        spec.attach(env.robot.make_spec(), prefix=f"{i}/", frame=spec.worldbody.add_frame())
    sky = spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    )
    sky.rgb1, sky.rgb2, sky.width, sky.height = [0.75, 0.85, 0.95], [1, 1, 1], 64, 384
    model = spec.compile()
    model.geom("terrain").rgba = [0.55, 0.62, 0.5, 1.0]
    data = mujoco.MjData(model)
    data.qpos[:] = poses.flatten()
    mujoco.mj_forward(model, data)

    camera = mujoco.MjvCamera()
    camera.lookat = poses[:, :3].mean(axis=0)
    extent = float(np.linalg.norm(np.ptp(poses[:, :3], axis=0)))
    camera.distance, camera.azimuth, camera.elevation = 0.75 * extent + 1.4, 100.0, -10.0
    options = mujoco.MjvOption()
    options.geomgroup[3] = 0  # collision shapes
    options.sitegroup[:] = 0
    with mujoco.Renderer(model, 700, 1600) as renderer:
        renderer.update_scene(data, camera, options)
        return renderer.render()


if __name__ == "__main__":
    tyro.cli(picture)
