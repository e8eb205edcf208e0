"""One run of a policy on a robot: reads, decides, guards, writes and records, once every control step."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller
from humoslope.deploy.onboard import guards, states
from humoslope.deploy.onboard.guards import Limits
from humoslope.deploy.onboard.messages import Command, Link, Reading, Remote
from humoslope.deploy.onboard.pilot import Heading, Pilot
from humoslope.deploy.onboard.states import DAMPING_NMS_RAD, Mode, Seen, State
from humoslope.deploy.onboard.unitree_g1 import MODE_MACHINE
from humoslope.deploy.quantities import Array

LISTEN_S = 0.3
"""Time for which a robot is listened to before anything is sent, s: whether somebody else commands it."""


class Gate:
    """The only way to the motors. Once closed it lets nothing through but damping.

    Attributes:
        reason: Why it was closed; empty while it is open.
        slowed: Number of commands whose targets were changed by the guards.
    """

    def __init__(self, link: Link, contract: Contract, limits: Limits, dry_run: bool = False) -> None:
        self._link, self._contract, self._limits, self._dry_run = link, contract, limits, dry_run
        self._lock = threading.Lock()
        self._before: Array | None = None
        self.reason = ""
        self.slowed = 0

    def send(self, command: Command, pose: Array) -> Command:
        """Sends a command as far as the guards allow, and returns what was sent.

        Args:
            command: The command.
            pose: [J] measured joint positions, rad, from which the targets start.
        """
        with self._lock:
            sent = states.damping(self._contract) if self.reason else self._guarded(command, pose)
            self._before = sent.target if sent.stiffness.any() else None
            if not self._dry_run:
                self._link.write(sent)
            return sent

    def _guarded(self, command: Command, pose: Array) -> Command:
        if command.stiffness.any() and np.isfinite(command.target).all():
            before = pose if self._before is None else self._before
            target = guards.allowed(command.target, before, self._contract, self._limits)
            self.slowed += not np.array_equal(target, command.target)
            command = Command(target, command.stiffness, command.damping)
        if (said := guards.unsendable(command, self._contract, self._limits, DAMPING_NMS_RAD)) is None:
            return command
        self.reason = said
        return states.damping(self._contract)

    def close(self, reason: str) -> None:
        """Damps the motors, now and for good. The first reason is kept."""
        with self._lock:
            self.reason = self.reason or reason
            if not self._dry_run:
                self._link.write(states.damping(self._contract))


@dataclass
class Ticks:
    """What happened, one entry for each control step, except for the first reading and the last command."""

    time: list[float] = field(default_factory=list)
    mode: list[Mode] = field(default_factory=list)
    reading: list[Reading] = field(default_factory=list)
    command: list[Array] = field(default_factory=list)
    action: list[Array] = field(default_factory=list)
    sent: list[Command] = field(default_factory=list)
    busy_s: list[float] = field(default_factory=list)


class Session:
    """A policy on a robot, from the first message to damping.

    Attributes:
        state: State of the machine.
        sending: True once the motors have been commanded.
        hindrance: Why the robot is not moved from where it is; None if nothing speaks against it.
        ticks: What happened so far.
        gate: The way to the motors.
        pilot: What a person asks for.

    Args:
        contract: The contract.
        controller: The policy.
        link: The robot.
        clock: Time in s, never decreasing.
        pilot: What a person asks for.
        limits: The guards' limits.
        mode_machine: Code of the build that the model is of.
        hold_heading: Hold the heading while no turn is commanded.
        latency_s: Time from a message of the robot until the command that answers it at once acts, s. The policy sees
            messages that are older by what is left to the age it was trained with.
        dry_run: Read and compute, and send nothing; the states then follow the requests alone.
        say: Called with each change of state, in words.
    """

    def __init__(
        self,
        contract: Contract,
        controller: Controller,
        link: Link,
        clock: Callable[[], float],
        pilot: Pilot,
        limits: Limits | None = None,
        mode_machine: int = MODE_MACHINE,
        hold_heading: bool = False,
        latency_s: float = 0.0,
        dry_run: bool = False,
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.contract, self._controller, self._link, self._clock = contract, controller, link, clock
        self._limits = limits or Limits()
        self.pilot, self._mode_machine, self._say = pilot, mode_machine, say
        self._heading = Heading(contract.commands.steering) if hold_heading else None
        self.gate = Gate(link, contract, self._limits, dry_run)
        self.state, self.sending = State(since=clock()), False
        self.hindrance: str | None = "the robot has not been heard of"
        self.ticks = Ticks()
        self._wait_s = max(0.0, contract.timing.observation_age_s - latency_s)
        self._first_heard: float | None = None
        self._heard: float | None = None  # time of the newest message
        self._count = -1
        self._beat = clock()
        self._last: Reading | None = None
        self._default = np.array([joint.default_rad for joint in contract.joints])
        self._scale = np.array([joint.action_scale_rad for joint in contract.joints])

    @property
    def over(self) -> bool:
        """True once the motors are damped."""
        return self.state.mode is Mode.DAMPING

    def tick(self) -> None:
        """One control step."""
        now = self._clock()
        self._beat = now
        reading = self._link.read()
        if reading is not None and reading.count != self._count:
            self._count, self._heard, self._last = reading.count, now, reading
            self._first_heard = now if self._first_heard is None else self._first_heard
        remote = Remote() if self._last is None else self._last.remote
        requests = self.pilot.requests(remote)
        self.hindrance = self._hindrance(now)
        seen = Seen(
            now,
            None if self._last is None else tuple(self._last.joint_pos),
            requests,
            self.hindrance,
            self._fault(now),
        )
        waited = self.state.mode is Mode.WAIT
        self._enter(states.advance(self.state, seen))
        if self._last is None or self.state.mode is Mode.WAIT or (waited and self.over):
            return
        self.sending = True
        if self.over:
            self.gate.close(self.state.reason)
            self._record(now, self._last, np.zeros(3), states.damping(self.contract))
            return
        asked, seen_now = self.pilot.command(remote), self._last
        walking = None
        if self.state.mode is Mode.WALK:
            if self._heading is not None:
                asked = self._heading(asked, self._last.quat_w)
            seen_now = self._link.read(self._wait_s) or self._last
            walking = self._controller(guards.measured(seen_now, self.contract, asked, self._controller.last_action))
        else:
            asked = np.zeros(3)
        command = states.command(self.state, now, self.contract, walking)
        assert command is not None
        sent = self.gate.send(command, self._last.joint_pos)
        if self.gate.reason:
            self._enter(State(Mode.DAMPING, now, reason=self.gate.reason))
        self._record(now, seen_now, asked, sent)

    def watch(self) -> bool:
        """Damps the motors if the loop has missed its ticks; returns whether it has. To be called from elsewhere."""
        late = self._clock() - self._beat
        most = self._limits.missed_ticks * self.contract.timing.control_step_s
        if late <= most or not self.sending or self.over:
            return False
        self.gate.close(f"the control loop stood still for {late:.2f} s")
        return True

    def stop(self, reason: str) -> None:
        """Damps the motors; at every exit, whatever led to it. A robot that was never commanded is left alone."""
        if self.sending:
            self.gate.close(reason)
        if not self.over:
            self._enter(State(Mode.DAMPING, self._clock(), reason=reason))

    def _hindrance(self, now: float) -> str | None:
        if self._last is None or self._first_heard is None:
            return "the robot has not been heard of"
        if self.state.mode is Mode.WAIT and self._link.foreign():
            return "somebody else commands the motors; put the robot into debug mode (L2 and R2), end other programs"
        if now - self._first_heard < LISTEN_S:
            return "listening whether somebody else commands the motors"
        return guards.unfit_to_start(self._last, self.contract, self._limits, self._mode_machine)

    def _fault(self, now: float) -> str | None:
        if self.gate.reason:
            return self.gate.reason
        if self._last is None or self._heard is None:
            return None
        if (silent := now - self._heard) > self._limits.silent_s:
            return f"the robot has been silent for {silent:.2f} s"
        if self.state.mode is not Mode.WAIT and self._link.foreign():
            return "somebody else commands the motors, too"
        if self.state.mode.upright and self._last.mode_machine != self._mode_machine:
            return f"the robot now says mode_machine {self._last.mode_machine}"
        return guards.unfit(self._last, self.contract, self._limits, tilt=self.state.mode.upright)

    def _enter(self, state: State) -> None:
        if state.mode is not self.state.mode:
            if state.mode is Mode.WALK:
                self._controller.reset()
            self._say(f"{state.mode.words}{f': {state.reason}' if state.reason else ''}")
        self.state = state

    def _record(self, now: float, reading: Reading, asked: Array, sent: Command) -> None:
        ticks = self.ticks
        ticks.time.append(now)
        ticks.mode.append(self.state.mode)
        ticks.reading.append(reading)
        ticks.command.append(asked)
        walks = self.state.mode is Mode.WALK
        held = (sent.target - self._default) / self._scale if sent.stiffness.any() else np.zeros(len(self._scale))
        ticks.action.append(self._controller.last_action.copy() if walks else held)
        ticks.sent.append(sent)
        ticks.busy_s.append(self._clock() - now)
