"""`humoslope deploy DIR`: an exported policy on a robot, over Unitree's SDK2 topics."""

from __future__ import annotations

import dataclasses
import math
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Annotated, ClassVar

import numpy as np
import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.onboard import pilot
from humoslope.deploy.onboard.drive import drive
from humoslope.deploy.onboard.guardian import Guardian
from humoslope.deploy.onboard.guards import Limits
from humoslope.deploy.onboard.keyboard import keyboard
from humoslope.deploy.onboard.log import to_rollout
from humoslope.deploy.onboard.pace import Pace, pace_on
from humoslope.deploy.onboard.pilot import Pilot
from humoslope.deploy.onboard.session import Session
from humoslope.deploy.onboard.states import Mode
from humoslope.deploy.onboard.unitree_g1 import MODE_MACHINE, motor_of_joint, require_measured
from humoslope.deploy.onboard.unitree_link import UnitreeLink, load_sdk
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.ranges import Checked, Finite, NotNegative, Positive

SAID_EVERY_S = 2.0
"""Time between two lines about what is waited for, s."""
NEXT = {
    Mode.WAIT: "ready: press start (s) to command the motors, which stay limp",
    Mode.ZERO_TORQUE: "ready: press start (s) again to move to the default pose",
    Mode.HOLD: "ready: press A (w) to walk",
}
"""What a person does next."""


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Runs an exported policy on a G1: wait, zero torque, move to the default pose, hold, walk, damping.

    Read docs/robot.md first. Nothing of this was ever tried on a real robot.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        interface: Network interface that leads to the robot; "lo" for a simulated one.
        dry_run: Read and compute, and send nothing to the motors.
        hold_heading: Hold the heading while no turn is commanded.
        speed: Forward speed to walk with until a stick or a key says otherwise, m/s.
        seconds: Longest time, s; by default until it is stopped.
        out: Rollout to record, for `humoslope replay` and `humoslope doctor`; by default in the current folder, named
            by the date.
        mode_machine: Code of the robot's build that the model is of.
        latency_ms: Time from a message of the robot until the command that answers it at once acts, ms.
        limits: Limits beyond which the motors are damped.
        slower: Let time pass so many times slower; for simulated robots on a machine that cannot keep up.
        tag: Hear only participants with this tag; for simulated robots.
    """

    VERB: ClassVar[str] = "deploy"

    folder: tyro.conf.Positional[Path]
    interface: str
    dry_run: bool = False
    hold_heading: bool = False
    speed: Finite = 0.0
    seconds: Positive | None = None
    out: Path | None = None
    mode_machine: int = MODE_MACHINE
    latency_ms: NotNegative = 4.0
    limits: Annotated[Limits, tyro.conf.arg(name="limit")] = dataclasses.field(default_factory=Limits)
    slower: float = 1.0
    tag: str = ""


def run(arguments: list[str]) -> None:
    """Runs the export named in `arguments` on a robot."""
    options = parse_options(Options, arguments, "deploy")
    out = options.out or Path(f"walk-{datetime.now():%Y-%m-%d-%H%M%S}.npz")
    check_place(out)
    pace = pace_on(options.interface, options.slower)
    folder = contracts.located(options.folder)
    contract = contracts.read(folder)
    motor_of_joint(contract)
    require_measured(contract)
    controller = Controller(contract, OnnxPolicy(folder, contract.network))
    _check_speed(options.speed, contract)
    load_sdk(options.interface)
    sdk_on_stderr()
    link = UnitreeLink(contract, options.interface, options.tag, pace)
    missed_s = options.limits.missed_ticks * contract.timing.control_step_s
    guardian = None if options.dry_run else Guardian(folder, options.interface, options.tag, pace, missed_s)
    console = Console()
    say = _Sayer(console, pace)
    session = Session(
        contract,
        controller,
        link,
        pace.now,
        Pilot(contract.commands, options.speed),
        options.limits,
        options.mode_machine,
        hold_heading=options.hold_heading,
        latency_s=1e-3 * options.latency_ms,
        dry_run=options.dry_run,
        say=say.state,
    )
    console.print(_introduction(contract, options), highlight=False, soft_wrap=True)
    stop, seconds = threading.Event(), options.seconds or math.inf
    try:
        with signals_set(stop), keyboard() as keys:
            drive(
                session,
                stop,
                pace,
                keys.pressed,
                guardian.beat if guardian else lambda: True,
                guardian.alive if guardian else lambda: True,
                seconds,
                lambda: say.waits(session),
            )
    finally:
        if guardian is not None:
            guardian.dismiss()
        link.close()
        _report(console, session, link)
        _save(console, folder, contract, session, out)
    asked_for = ("stop was asked for", "the program was asked to end", f"{seconds:g} s are over")
    if session.state.reason not in asked_for:
        raise UserError(f"the motors were damped: {session.state.reason}.")


def sdk_on_stderr() -> None:
    """Keeps what Unitree's SDK prints out of the standard output, which stays this program's."""
    sys.stdout.flush()
    ours = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(ours, "w", buffering=1)


class _Sayer:
    """Says each state, what is to be done next, and from time to time what hinders it."""

    def __init__(self, console: Console, pace: Pace) -> None:
        self._console, self._clock, self._begun = console, pace.now, pace.now()
        self._said, self._before = "", self._begun

    def state(self, text: str) -> None:
        self._line(text)
        self._said, self._before = "", -math.inf

    def waits(self, session: Session) -> None:
        mode, now = session.state.mode, self._clock()
        hindered = mode is not Mode.HOLD and session.hindrance is not None
        text = f"not yet: {session.hindrance}" if hindered else NEXT.get(mode, "")
        if text and text != self._said and now - self._before > SAID_EVERY_S:
            self._said, self._before = text, now
            self._line(text)

    def _line(self, text: str) -> None:
        self._console.print(f"{self._clock() - self._begun:7.2f} s  {text}", highlight=False, soft_wrap=True)


@contextmanager
def signals_set(stop: threading.Event) -> Iterator[None]:
    """Inside the block, signals to end only set `stop`: the loop ends by itself, in damping."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    previous = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _check_speed(speed: float, contract: Contract) -> None:
    low, high = contract.commands.forward_m_s
    if not min(low, 0.0) <= speed <= max(high, 0.0):
        raise UserError(f"--speed {speed:g} must be between {min(low, 0.0):g} and {max(high, 0.0):g} m/s.")


def _introduction(contract: Contract, options: Options) -> str:
    timing, training = contract.timing, contract.training
    dry = "[bold]dry run: nothing is sent to the motors[/bold]\n" if options.dry_run else ""
    return (
        f"[bold]{training.title}[/bold], on {options.interface}\n{dry}"
        f"{1.0 / timing.control_step_s:g} commands a second, observations {1e3 * timing.observation_age_s:g} ms old\n"
        "[bold]Never tried on a real robot. Keep the gantry on, and the remote (select stops) in your hand.[/bold]\n"
        f"remote: start to command the motors and again to move, A to walk, select or L2+B to stop; keys: {pilot.KEYS}"
    )


def _report(console: Console, session: Session, link: UnitreeLink) -> None:
    ticks = session.ticks
    if len(ticks.time) < 2:
        return
    busy, period = 1e3 * np.array(ticks.busy_s), 1e3 * np.diff(ticks.time)
    walked = sum(mode is Mode.WALK for mode in ticks.mode) * session.contract.timing.control_step_s
    console.print(
        f"walked for {walked:.1f} s; a tick took {np.median(busy):.2f} ms (median), {np.quantile(busy, 0.99):.2f} ms "
        f"(99 %), {busy.max():.2f} ms (most); from tick to tick at most {period.max():.1f} ms\n"
        f"targets held back by the guards in {session.gate.slowed} of {len(ticks.time)} ticks; "
        f"{link.inbox.refused} messages refused",
        highlight=False,
        soft_wrap=True,
    )


def _save(console: Console, folder: Path, contract: Contract, session: Session, out: Path) -> None:
    if len(session.ticks.time) < 3:
        console.print("the robot was never commanded; no walk was recorded", highlight=False)
        return
    rollout, more = to_rollout(folder, contract, session.ticks, out.stem)
    rollout.save(out, **more)
    console.print(f"wrote {out}: `humoslope replay {out}` shows it", highlight=False, soft_wrap=True)
