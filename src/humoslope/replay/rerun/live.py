"""Live view of a training in rerun: a few robots on their ground, what they are commanded and do, and the curves.

The viewer's server is a process of its own. Training sends to it only while somebody is connected to it, and never
spends more than a share of its processor time on sending; while nobody looks, it only looks for somebody now and then.
Processor time is what counts, so that a machine that others use does not make a view dear.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from humoslope.interrupts import die_with_parent
from humoslope.replay.rerun import colours
from humoslope.replay.rerun.layout import EYE
from humoslope.replay.rerun.scene import OVERHEAD, mesh
from humoslope.replay.rerun.viewer import check_ports, program, wait_for_page
from humoslope.replay.robot import RobotShape
from humoslope.replay.shapes import Shape, joined, surface
from humoslope.screen import HOST

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

RATE_HZ = 10.0
"""Pictures per second of wall-clock time while somebody looks."""
SHARE = 0.04
"""Largest share of the processor time of training that is spent on sending, while somebody looks."""
LOOK_S = 1.0
"""Processor time between two looks for somebody, s. A look takes some milliseconds, as Linux goes through all its
connections for it."""
MEMORY = "256MB"
"""What the server keeps for those who come later; the oldest pictures are dropped."""
CURVES = {
    "reward": "Train/reward",
    "falls per second": "Train/falls_per_second",
    "speed": "Train/speed",
    "harness": "Curriculum/harness",
    "terrain level": "Curriculum/terrain_levels",
    "episode length": "Train/episode_length",
}
"""Curves that are shown, by their titles."""
TCP = Path("/proc/net/tcp")
"""Where Linux lists connections; the server listens on an address of the fourth version alone."""
ESTABLISHED = "01"
TIME = "training"


class LiveView:
    """Sends the state of a few envs to rerun; an `Onlooker` of a training, in which it changes nothing.

    Args:
        env: The environment.
        recording: Where everything is sent.
        worlds: Number of envs that are shown, spread over the columns of the terrain.
        is_watched: Says at a processor time, s, whether somebody looks.

    Attributes:
        is_watched: Says whether somebody looks.
        sent: Number of pictures that were sent.

    Raises:
        UserError: If the robot's URDF cannot be read.
    """

    def __init__(
        self, env: Env, recording: rr.RecordingStream, worlds: int, is_watched: Callable[[float], bool]
    ) -> None:
        count = min(worlds, env.num_envs)
        self._env, self._recording, self.is_watched = env, recording, is_watched
        self._chosen = torch.arange(count, device=env.device) * env.num_envs // count
        self._robot = RobotShape(env.robot.urdf.read_text(encoding="utf-8"))
        self._last, self._began = time.monotonic(), time.thread_time()
        self._spent, self._step, self.sent = 0.0, 0, 0
        self._origins: NDArray[np.float32] | None = None
        self._describe(count)

    def after_step(self) -> None:
        """Sends a picture if somebody looks, and it is time for one."""
        self._step += 1
        now = time.monotonic()
        if now - self._last < 1.0 / RATE_HZ:
            return
        begin = time.thread_time()
        if not self.is_watched(begin):
            self._began, self._spent = begin, 0.0  # what was not spent before is not to be made up for
            return
        if self._spent > SHARE * (begin - self._began):
            return
        self._last = now
        self._send()
        self._spent += time.thread_time() - begin

    def after_iteration(self, iteration: int, values: dict[str, float]) -> None:
        """Sends a point of each curve. They are few, and who comes later sees them from the beginning."""
        self._recording.set_time(TIME, duration=self._step * self._env.step_dt)
        for title, tag in CURVES.items():
            if tag in values:
                self._recording.log(_place(title), rr.Scalars(values[tag]))

    def close(self, finished: bool) -> None:
        """Says that nothing more will come."""
        self._recording.log("events", rr.TextLog("training is complete" if finished else "training was stopped"))
        self._recording.disconnect()

    def _describe(self, count: int) -> None:
        """Sends what does not change: the layout, and the shapes of the robot."""
        views = [
            rrb.Spatial3DView(
                origin=f"/world/followed/{i}",
                contents="/world/**",
                name=f"env {int(env)}",
                background=rrb.Background(kind="GradientBright"),
                line_grid=rrb.LineGrid3D(visible=False),
                eye_controls=rrb.EyeControls3D(position=EYE, look_target=(0.0, 0.0, -0.1), eye_up=(0.0, 0.0, 1.0)),
            )
            for i, env in enumerate(self._chosen.tolist()[:count])
        ]
        curves = [rrb.TimeSeriesView(origin=f"/{_place(title)}", name=title) for title in CURVES]
        panel = rrb.TimePanel(timeline=TIME, state="collapsed", play_state="following")
        whole = rrb.Horizontal(rrb.Grid(*views), rrb.Vertical(*curves), column_shares=[3, 1])
        self._recording.send_blueprint(rrb.Blueprint(whole, panel, collapse_panels=True))
        self._recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for link, shape in self._robot.shapes.items():
            self._recording.log(f"world/robot/{link}", mesh(shape), static=True)

    def _send(self) -> None:
        """Sends the present moment. Waits for the device."""
        env, chosen, recording = self._env, self._chosen, self._recording
        signals = env.signals
        taken = (
            *(signals.root_pos_w, signals.root_quat_w, signals.joint_pos, signals.root_lin_vel_w),
            *(env.commands.velocity, env.tiles.origin_w, signals.heading_w[:, None]),
        )
        widths = [tensor.shape[1] for tensor in taken]
        whole = torch.cat([tensor[chosen].float() for tensor in taken], dim=1).cpu().numpy()
        root, quat, joints, velocity, command, origins, heading = np.split(whole, np.cumsum(widths)[:-1], axis=1)
        recording.set_time(TIME, duration=self._step * env.step_dt)
        if self._origins is None or not np.array_equal(self._origins, origins):
            recording.log("world/ground", mesh(self._ground(origins)))
            self._origins = origins
        poses = self._robot.poses_of(env.robot.root_body, env.robot.joint_names, root, quat, joints)
        for link in self._robot.shapes:
            turned = Rotation.from_matrix(poses[link].rotation).as_quat()
            recording.log(
                f"world/robot/{link}", rr.InstancePoses3D(translations=poses[link].position, quaternions=turned)
            )
        for i, place in enumerate(root):
            recording.log(f"world/followed/{i}", rr.Transform3D(translation=place))
        over = root + np.array((0.0, 0.0, OVERHEAD), np.float32)
        ahead = np.concatenate([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=1)
        left = np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=1)
        asked = command[:, :1] * ahead + command[:, 1:2] * left
        recording.log("world/commanded", rr.Arrows3D(origins=over, vectors=asked, colors=[colours.COMMANDED]))
        recording.log("world/actual", rr.Arrows3D(origins=over, vectors=velocity, colors=[colours.ACTUAL]))
        self.sent += 1

    def _ground(self, origins: NDArray[np.float32]) -> Shape:
        """The tiles with these origins [K, 3]; each one once."""
        env, tiles = self._env, []
        cell = env.terrain.cell
        for x0, y0, _ in np.unique(origins, axis=0):
            x = x0 + cell * np.arange(round(env.tiles.length / cell) + 1)
            y = y0 - 0.5 * env.tiles.width + cell * np.arange(round(env.tiles.width / cell) + 1)
            places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).astype(np.float32)
            heights = env.terrain.height(torch.as_tensor(places, device=env.device)).cpu().numpy()
            tiles.append(surface(x, y, heights, (float(x0), float(y0))))
        return joined(tiles)


class Watched:
    """Says whether a viewer is connected to a port of this machine, by a look once in `LOOK_S`.

    Training itself is connected to it too. Where connections are not listed, as on macOS, it is always watched.
    """

    def __init__(self, port: int, own: int = 1) -> None:
        """Args:
        port: Port of the server.
        own: Connections that are not viewers.
        """
        self._port, self._own = f":{port:04X}", own
        self._looked, self._watched = -LOOK_S, False

    def __call__(self, now: float) -> bool:
        """True if somebody looked at the last look; `now` is the processor time, s."""
        if now - self._looked >= LOOK_S:
            self._looked = now
            self._watched = self.connections() > self._own if TCP.exists() else True
        return self._watched

    def connections(self) -> int:
        """Connections to the port at present."""
        if not TCP.exists():
            return 0
        rows = [line.split()[1:4] for line in TCP.read_text(encoding="ascii").splitlines()[1:]]
        return sum(local.endswith(self._port) and state == ESTABLISHED for local, _, state in rows)


@contextmanager
def live_view(env: Env, worlds: int, web_port: int, port: int, title: str) -> Iterator[tuple[LiveView, str]]:
    """A live view of an environment in a browser on this machine, and the address of its page, while inside.

    Args:
        worlds: Number of envs that are shown.
        web_port: Port of the page.
        port: Port that training sends to, and from which the page reads.
        title: Name of the recording.

    Raises:
        UserError: If a port is in use, or the server does not come up.
    """
    check_ports(web_port, port)
    source = f"rerun+http://{HOST}:{port}/proxy"
    command = [program(), "--serve-web", "--bind", HOST, "--port", str(port), "--web-viewer-port", str(web_port)]
    with tempfile.TemporaryFile("w+") as said:
        server = subprocess.Popen(
            [*command, "--server-memory-limit", MEMORY],
            stdout=said,
            stderr=said,
            start_new_session=True,  # Ctrl-C in the terminal is for training, which ends the server
            preexec_fn=die_with_parent,  # noqa: PLW1509
        )
        try:
            for number in (web_port, port):
                wait_for_page(server, number, said)
            recording = rr.RecordingStream("humoslope training")
            recording.connect_grpc(source)
            recording.send_recording_name(title)
            yield (
                LiveView(env, recording, worlds, Watched(port)),
                f"http://{HOST}:{web_port}/?url={quote(source, safe='')}",
            )
        finally:
            server.terminate()
            server.wait()


def _place(title: str) -> str:
    """Entity of a curve."""
    return f"curves/{title.replace(' ', '_')}"
