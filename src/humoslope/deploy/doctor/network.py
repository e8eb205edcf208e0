"""Whether the recorded actions are those of the network, and if not, with which mistake they would be."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from humoslope.deploy.contract import Contract, ObservationGroup
from humoslope.deploy.controller import GaitPhase, Input, Observer, OnnxPolicy
from humoslope.deploy.doctor.walk import Finding, Walk
from humoslope.deploy.quantities import Array, Measured

CHECK = "network"
SAME = 1e-3
"""Root mean square difference of actions up to which they are the same."""
EXPLAINED = 0.1
"""A mistake explains the actions if it leaves at most this share of the difference."""
STEPS = 120
"""Control steps that are compared for each mistake."""
LATEST = 4
"""Longest delay that is tried, control steps."""
SCALES = (0.05, 0.25, 0.5, 2.0, 20.0, 180.0 / np.pi)
"""Factors that are tried, among them the usual scales of peers and degrees."""


@dataclass(frozen=True)
class Mistake:
    """A way to make observations that is not the contract's.

    Attributes:
        words: What is wrong.
        walk: Changes the measurements.
        scale: Factor on the terms of a quantity, by its name.
        newest_first: The history begins with the newest frame.
        interleaved: All terms of a frame together, frame by frame.
    """

    words: str
    walk: Callable[[Walk], Walk] = lambda walk: walk
    scale: dict[str, float] = field(default_factory=dict)
    newest_first: bool = False
    interleaved: bool = False


NONE = Mistake("none")


def check(walk: Walk, contract: Contract, policy: OnnxPolicy) -> Finding:
    """Compares the recorded actions with the network's, and looks for the mistake if they differ."""
    right = difference(walk, contract, policy, NONE, len(walk))
    if right <= SAME:
        return Finding(CHECK, False, f"gives the recorded actions; they differ by {right:.1g}")
    found = sorted(
        ((difference(walk, contract, policy, mistake, STEPS), mistake.words) for mistake in mistakes(contract)),
        key=lambda pair: pair[0],
    )
    best, words = found[0]
    short = difference(walk, contract, policy, NONE, STEPS)
    if best <= max(SAME, EXPLAINED * short):
        return Finding(CHECK, True, f"{words}: then the actions differ by {best:.1g} instead of {short:.1g}")
    return Finding(
        CHECK, True, f"its actions differ by {right:.2g} from the recorded ones; closest: {words}, {best:.2g}"
    )


def difference(walk: Walk, contract: Contract, policy: OnnxPolicy, mistake: Mistake, steps: int) -> float:
    """Returns the root mean square difference of actions, without the first steps, whose history is not known.

    Args:
        walk: The walk.
        contract: The contract.
        policy: The network.
        mistake: How observations are made.
        steps: Number of control steps.
    """
    seen = mistake.walk(walk)
    groups = [_mistaken(group, mistake) for group in contract.observations]
    observers = {group.name: Observer(group) for group in groups}
    phase = None if contract.gait_clock is None else GaitPhase(contract.gait_clock, contract.timing.control_step_s)
    default = np.array([joint.default_rad for joint in contract.joints])
    skipped = max(group.history for group in groups) + LATEST
    total, count = 0.0, 0
    for k in range(min(steps + skipped, len(walk))):
        measured = Measured(
            root_quat_w=seen.quat_w[k] / np.linalg.norm(seen.quat_w[k]),
            root_ang_vel_b=seen.ang_vel_b[k],
            joint_pos_rel=seen.joint_pos[k] - default,
            joint_vel=seen.joint_vel[k],
            command=seen.command[k],
            last_action=seen.action[k - 1] if k else np.zeros(len(default)),
        )
        if phase is not None:
            measured = dataclasses.replace(measured, gait_phase=phase(measured.command))
        observations = {name: observe(measured) for name, observe in observers.items()}
        if k < skipped:
            continue
        for group in groups:
            observations[group.name] = _laid_out(observations[group.name], group, mistake)
        total += float(np.square(policy(observations) - walk.action[k]).mean())
        count += 1
    return float(np.sqrt(total / max(count, 1)))


def mistakes(contract: Contract) -> Iterator[Mistake]:
    """The mistakes that are tried."""
    names = [joint.name for joint in contract.joints]
    for term in contract.observations[0].terms:
        yield Mistake(f"{term.quantity} has the opposite sign", scale={term.quantity: -1.0})
        yield Mistake(f"{term.quantity} is missing (zero)", scale={term.quantity: 0.0})
        for scale in {*SCALES, 1.0 / term.scale if term.scale else 1.0} - {1.0}:
            yield Mistake(f"{term.quantity} is scaled by {scale:.3g}", scale={term.quantity: float(scale)})
    yield Mistake("the history is newest first", newest_first=True)
    yield Mistake("the history is laid out frame by frame", interleaved=True)
    for what, fields in (
        ("the IMU is", ("quat_w", "ang_vel_b")),
        ("the encoders are", ("joint_pos", "joint_vel")),
        ("all measurements are", ("quat_w", "ang_vel_b", "joint_pos", "joint_vel")),
        ("the last action is", ("action",)),
        ("the command is", ("command",)),
    ):
        for late in range(1, LATEST + 1):
            yield Mistake(f"{what} {late} control steps late", walk=_late(fields, late))
    for words, order in (
        ("left and right joints are exchanged", _mirrored(names)),
        ("joints are in alphabetical order", sorted(range(len(names)), key=lambda joint: names[joint])),
        ("joints are in the order of breadth, left and right in turn", _breadth(names)),
    ):
        yield Mistake(words, walk=_permuted(order))
        yield Mistake(f"{words}, in the measurements alone", walk=_permuted(order, ("joint_pos", "joint_vel")))
    yield Mistake("quaternions are x, y, z, w", walk=_xyzw)


def _late(fields: tuple[str, ...], steps: int) -> Callable[[Walk], Walk]:
    def change(walk: Walk) -> Walk:
        return dataclasses.replace(walk, **{name: _earlier(getattr(walk, name), steps) for name in fields})

    return change


def _earlier(values: Array, steps: int) -> Array:
    return np.concatenate([np.repeat(values[:1], steps, axis=0), values[:-steps]])


def _permuted(
    order: Sequence[int], fields: tuple[str, ...] = ("joint_pos", "joint_vel", "action")
) -> Callable[[Walk], Walk]:
    index = np.asarray(order, dtype=np.int64)

    def change(walk: Walk) -> Walk:
        return dataclasses.replace(walk, **{name: getattr(walk, name)[:, index] for name in fields})

    return change


def _xyzw(walk: Walk) -> Walk:
    return dataclasses.replace(walk, quat_w=walk.quat_w[:, [1, 2, 3, 0]])


def _mirrored(names: list[str]) -> list[int]:
    other = [name.replace("left", "\0").replace("right", "left").replace("\0", "right") for name in names]
    return [names.index(name) for name in other]


def _breadth(names: list[str]) -> list[int]:
    """Joints by their depth below the root, as Isaac Lab lists those of a G1: left, right, waist in turn."""
    chains: dict[str, list[str]] = {}
    for name in names:
        limb = "arm" if any(part in name for part in ("shoulder", "elbow", "wrist")) else "leg"
        side = "left" if "left" in name else "right" if "right" in name else "waist"
        chains.setdefault(f"{side} {'' if side == 'waist' else limb}", []).append(name)
    waist = max((len(chain) for key, chain in chains.items() if key.startswith("waist")), default=0)
    depth = {
        name: k + (waist if key.endswith("arm") else 0) for key, chain in chains.items() for k, name in enumerate(chain)
    }
    return sorted(range(len(names)), key=lambda joint: (depth[names[joint]], joint))


def _mistaken(group: ObservationGroup, mistake: Mistake) -> ObservationGroup:
    terms = tuple(
        dataclasses.replace(term, scale=term.scale * mistake.scale.get(term.quantity, 1.0)) for term in group.terms
    )
    return dataclasses.replace(group, terms=terms)


def _laid_out(observation: Input, group: ObservationGroup, mistake: Mistake) -> Input:
    """An observation of the contract's layout in the mistake's."""
    if not (mistake.newest_first or mistake.interleaved):
        return observation
    terms, start = [], 0
    for term in group.terms:
        size = term.shape[0]
        frames = observation[start : start + group.history * size].reshape(group.history, size)
        terms.append(frames[::-1] if mistake.newest_first else frames)
        start += group.history * size
    if mistake.interleaved:
        return np.concatenate(terms, axis=1).ravel()
    return np.concatenate([frames.ravel() for frames in terms])
