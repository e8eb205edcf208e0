"""A session with a simulated robot in the same process, on simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.onboard import session, simulated, states
from humoslope.deploy.onboard.person import Person
from humoslope.deploy.onboard.pilot import Pilot
from humoslope.deploy.onboard.session import Session
from humoslope.deploy.onboard.simulated import Faults, InProcessLink, SimulatedRobot

SCRIPT = "0.2:start 0.5:start 3.6:lower 5:A 5:forward=0.625 5.3:release"
"""From the gantry: the robot walks after 5 s."""
SHORT = "0.15:start 0.4:start 0.4:lower 0.8:A 0.8:forward=0.625 1:release"
"""From the ground: the robot walks after 0.8 s, where the move takes 0.3 s."""


@dataclass
class Stage:
    """A robot, the link to it, and the session that moves it."""

    robot: SimulatedRobot
    link: InProcessLink
    session: Session
    said: list[tuple[float, str]]
    damped_at: list[float] = field(default_factory=list)

    def run(self, until: float) -> Stage:
        """Ticks until a time; notes when the motors are first damped."""
        while self.link.clock() < until - 1e-6:
            self.session.tick()
            self.link.run(0.02)
        return self


@pytest.fixture(autouse=True, scope="package")
def soon() -> Iterator[None]:
    """A robot is listened to for 0.1 s, so that start can be pressed twice in half a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "LISTEN_S", 0.1)
        yield


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The way to the default pose takes 0.3 s; a robot that stands in it need not be moved for longer."""
    monkeypatch.setattr(states, "MOVE_S", 0.3)


@pytest.fixture(scope="session")
def stage(exported: Path, contract: Contract) -> Callable[..., Stage]:
    """stage(script=..., grade=..., faults=..., **options of a session): ready to run."""

    def make(
        script: str = SHORT,
        grade: float = 0.0,
        faults: Faults | None = None,
        folder: Path = exported,
        contract: Contract = contract,
        **options: Any,
    ) -> Stage:
        lifted = simulated.LIFTED_M if script.startswith(SCRIPT) else 0.0
        robot = SimulatedRobot(folder, contract, grade, faults=faults or Faults(), lifted=lifted)
        person, damped = Person(script), []  # type: Person, list[float]

        def beside(robot: SimulatedRobot) -> None:
            person.act(robot)
            if robot.damped and not damped:
                damped.append(robot.time)

        link = InProcessLink(robot, beside)
        said: list[tuple[float, str]] = []
        controller = Controller(contract, OnnxPolicy(folder, contract.network))
        running = Session(
            contract,
            controller,
            link,
            link.clock,
            Pilot(contract.commands),
            say=lambda text: said.append((link.clock(), text)),
            **options,
        )
        return Stage(robot, link, running, said, damped)

    return make
