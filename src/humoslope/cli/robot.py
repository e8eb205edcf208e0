"""`humoslope robot DIR`: a simulated G1 as a process of its own, for `humoslope deploy`."""

from __future__ import annotations

import dataclasses
import threading
import time
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.cli.deploy import sdk_on_stderr, signals_set
from humoslope.deploy import contract as contracts
from humoslope.deploy.onboard.pace import Pace, pace_on
from humoslope.deploy.onboard.person import Person
from humoslope.deploy.onboard.simulated import Faults, SimulatedRobot
from humoslope.deploy.onboard.unitree_link import PERIOD_S, UnitreeRobot, load_sdk
from humoslope.deploy.player import Slope
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.ranges import Checked, NotNegative, Positive, Seed, Timestep
from humoslope.seal import finite, write_json

BEHIND_S = 0.1
"""Time by which the simulation may fall behind before it gives up catching up, s."""


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Simulates a G1 that `humoslope deploy DIR --interface lo` moves: motors, sensors, gantry, remote, ground, faults.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        interface: Network interface; only the loopback is allowed.
        tag: Speak only to participants with this tag.
        grade: Grade of a ramp, degrees; negative goes down, 0 is flat ground.
        cross: Slope across the course, degrees; only without a ramp.
        friction: Coefficient of friction between feet and ground.
        script: Actions of the person beside it, such as "1:start 5:lower 8:A 8:forward=0.6 8.5:release 20:select". Each
            time, s, counts from the first command to the motors, for which the person presses start until it comes; a
            word is a button, lower, release, or a stick and its deflection.
        seconds: Time to simulate, s; by default until it is interrupted.
        timestep: Physics step, s; the contract's by default.
        slower: Let time pass so many times slower, as `humoslope deploy` with the same option.
        faults: Faults of its messages and its motors.
        seed: Seed of noise and lost messages.
        out: JSON file of events, with the true place of the robot.
    """

    VERB: ClassVar[str] = "robot"

    folder: tyro.conf.Positional[Path]
    interface: str = "lo"
    tag: str = ""
    grade: Slope = 0.0
    cross: Slope = 0.0
    friction: NotNegative = 1.0
    script: str = "1:start 5:lower 8:A 8:forward=0.6 8.5:release"
    seconds: Positive | None = None
    timestep: Timestep | None = None
    slower: float = 1.0
    faults: Annotated[Faults, tyro.conf.arg(name="fault")] = dataclasses.field(default_factory=Faults)
    seed: Seed = 0
    out: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grade and self.cross:
            raise UserError("robot: --grade and --cross cannot be combined; one must be 0.")


def run(arguments: list[str]) -> None:
    """Simulates the robot of the export named in `arguments`."""
    options = parse_options(Options, arguments, "robot")
    if options.out is not None:
        check_place(options.out)
    folder = contracts.located(options.folder)
    contract = contracts.read(folder)
    pace, person = pace_on(options.interface, options.slower), Person(options.script, waits=True)
    robot = SimulatedRobot(
        folder,
        contract,
        options.grade,
        options.cross,
        options.friction,
        options.faults,
        seed=options.seed,
        timestep_s=options.timestep,
    )
    load_sdk(options.interface, only_loopback=True)
    sdk_on_stderr()
    side, console = UnitreeRobot(contract, options.interface, options.tag), Console()
    console.print(f"a simulated {contract.robot.name} on {options.interface}", highlight=False)
    stop = threading.Event()
    happened = _Happened(robot, console)
    with signals_set(stop):
        _live(robot, side, person, happened, options.seconds or float("inf"), stop, pace)
    if options.out is not None:
        write_json(options.out, finite(happened.result()))


def _live(
    robot: SimulatedRobot,
    side: UnitreeRobot,
    person: Person,
    happened: _Happened,
    seconds: float,
    stop: threading.Event,
    pace: Pace,
) -> None:
    """Steps the robot in real time. Every 2 ms it hears, and says how it is."""
    dt, begun, spoken = float(robot.world.model.opt.timestep), pace.now(), 0
    while not stop.is_set() and robot.time < seconds:
        now = pace.now() - begun
        if (command := side.hear()) is not None:
            robot.receive(command)
            happened.look(time.time())
        if now - robot.time > BEHIND_S:
            happened.behind += now - robot.time
            begun += now - robot.time
            continue
        while robot.time + dt <= now:
            person.act(robot)
            robot.step()
        if now >= spoken * PERIOD_S:
            spoken = int(now / PERIOD_S) + 1
            if (reading := robot.say()) is not None:
                side.say(reading)
            if spoken % 5 == 0:
                side.press(robot.remote)
        happened.look(time.time())
        stop.wait(pace.real(max(0.0, spoken * PERIOD_S - (pace.now() - begun))))


class _Happened:
    """What happened to the robot, as it really was."""

    def __init__(self, robot: SimulatedRobot, console: Console) -> None:
        self._robot, self._console = robot, console
        self._before = ""
        self.behind = 0.0
        self._events: list[dict[str, Any]] = []
        self._path: list[tuple[float, float, float, float]] = []

    def look(self, now: float) -> None:
        """Notes a change of what the motors do; `now` is the time of the day in s."""
        robot = self._robot
        silent = robot.faults.silent_at_s
        does = "held" if robot.held else "damped" if robot.damped else "limp"
        if silent is not None and robot.time >= silent:
            does += ", silent"
        x, y, z = (float(value) for value in robot.world.data.qpos[:3])
        if not self._path or robot.time - self._path[-1][0] >= 0.1:
            self._path.append((robot.time, x, y, z))
        if does != self._before:
            self._before = does
            self._events.append({"time": robot.time, "wall": now, "motors": does, "x": x, "hung": robot.hung})
            self._console.print(f"{robot.time:7.2f} s  motors {does}, x {x:.2f} m", highlight=False)

    def result(self) -> dict[str, Any]:
        """Events, way and whether it kept up with time, for JSON."""
        return {"events": self._events, "path": self._path, "behind_s": self.behind, "commands": self._robot.commands}
