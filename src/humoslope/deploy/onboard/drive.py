"""A session in real time: the loop, its watchdog, and damping at every exit."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterable

from humoslope.deploy.onboard.pace import Pace
from humoslope.deploy.onboard.session import Session

REAL_TIME = Pace()
DAMPED_S = 0.5
"""Time for which damping is repeated at the end, s; the robot keeps the last command."""


def drive(
    session: Session,
    stop: threading.Event,
    pace: Pace = REAL_TIME,
    keys: Callable[[], Iterable[str]] = lambda: (),
    beat: Callable[[], bool] = lambda: True,
    alive: Callable[[], bool] = lambda: True,
    seconds: float = float("inf"),
    report: Callable[[], object] = lambda: None,
) -> None:
    """Runs a session until it is over, and damps the motors whatever ends it.

    Args:
        session: The session, whose clock is that of `pace`.
        stop: Set from elsewhere, such as a signal handler, to end it.
        pace: The clock.
        keys: Returns the keys pressed since the last call.
        beat: Called every control step once the motors have been commanded; returns whether whoever guards this process
            is there.
        alive: Called before, and returns the same: a guardian that has heard a beat damps the robot.
        seconds: Longest time, s.
        report: Called every control step after the work of it.
    """
    dt = session.contract.timing.control_step_s
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(pace.real(0.5 * dt)):
            session.watch()

    watchdog = threading.Thread(target=watch, daemon=True, name="watchdog")
    reason = "the program failed"
    gc.collect()
    gc.freeze()  # a collection of everything that was loaded takes as long as a control step
    try:
        watchdog.start()
        begun = due = pace.now()
        while not session.over:
            if stop.is_set():
                reason = "the program was asked to end"
                break
            if due - begun > seconds:
                reason = f"{seconds:g} s are over"
                break
            if not (beat() if session.sending else alive()):
                reason = "the guardian process has ended"
                break
            for key in keys():
                session.pilot.press(key)
            session.tick()
            report()
            due += dt
            if (late := pace.now() - due) > dt:
                due += late  # missed steps are not made up for
            stop.wait(pace.real(max(0.0, due - pace.now())))
    except KeyboardInterrupt:
        reason = "the program was interrupted"
        raise
    finally:
        _damp(session, reason, beat)
        ended.set()
        gc.unfreeze()


def _damp(session: Session, reason: str, beat: Callable[[], bool]) -> None:
    """Repeats damping for a while. A second signal does not end this."""
    end = time.monotonic() + DAMPED_S
    while True:
        try:
            session.stop(reason)
            while session.sending and time.monotonic() < end:
                session.gate.close(reason)
                beat()
                time.sleep(0.02)
        except KeyboardInterrupt:
            continue
        return
