"""Whatever happens, in whatever order, the robot goes through its states as they are drawn."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard import states
from humoslope.deploy.onboard.states import DAMPING_NMS_RAD, MOVE_S, Mode, Request, Seen, State, advance

WAY = [Mode.WAIT, Mode.ZERO_TORQUE, Mode.MOVE, Mode.HOLD, Mode.WALK]
poses = st.none() | st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
steps = st.tuples(
    st.floats(0.0, 2.0), poses, st.frozensets(st.sampled_from(Request)), st.sampled_from([None, "leans"]),
    st.sampled_from([None, None, None, "silent"]),
)  # fmt: skip


@given(st.lists(steps, max_size=40))
def test_states_follow_each_other_on_the_way_or_end_in_damping(happens: list[tuple[object, ...]]) -> None:
    state, now = State(), 0.0
    for wait, pose, requests, hindrance, fault in happens:
        now += wait  # type: ignore[operator]
        before, seen = state, Seen(now, pose, requests, hindrance, fault)  # type: ignore[arg-type]
        state = advance(before, seen)
        if before.mode is Mode.DAMPING:
            assert state == before  # for good
        elif state.mode is Mode.DAMPING:
            assert Request.STOP in seen.requests or seen.fault is not None
            assert state.reason
        elif state.mode is not before.mode:
            assert WAY.index(state.mode) == WAY.index(before.mode) + 1
            assert state.since == now
            if state.mode in (Mode.ZERO_TORQUE, Mode.MOVE):
                assert Request.START in seen.requests  # the first command, too, is asked for
            if state.mode is Mode.WALK:
                assert Request.WALK in seen.requests
        if Request.STOP in seen.requests:
            assert state.mode is Mode.DAMPING
        if seen.fault is not None and before.mode is not Mode.WAIT:
            assert state.mode is Mode.DAMPING


@given(
    poses, st.sampled_from([None, "leans"]), st.sampled_from([None, "silent"]), st.frozensets(st.sampled_from(Request))
)
def test_nothing_moves_a_robot_that_is_not_fit_to_start(
    pose: tuple[float, float] | None, hindrance: str | None, fault: str | None, requests: frozenset[Request]
) -> None:
    for mode in (Mode.WAIT, Mode.ZERO_TORQUE):
        state = advance(State(mode), Seen(1.0, pose, requests, hindrance, fault))
        if hindrance is not None or fault is not None or pose is None:
            assert state.mode in (mode, Mode.DAMPING)


def test_walking_needs_a_request_in_the_pose_to_walk_from() -> None:
    """A request that came before is not kept: the button has to be pressed when the robot stands."""
    state = State(Mode.MOVE, 0.0, (0.0, 0.0))
    for now in np.arange(0.0, MOVE_S, 0.02):
        state = advance(state, Seen(now, (0.0, 0.0), frozenset({Request.WALK})))
        assert state.mode is Mode.MOVE
    state = advance(state, Seen(MOVE_S, (0.0, 0.0)))
    assert state.mode is Mode.HOLD
    assert advance(state, Seen(9.0, (0.0, 0.0))).mode is Mode.HOLD
    assert advance(state, Seen(9.0, (0.0, 0.0), frozenset({Request.WALK}))).mode is Mode.WALK


@given(st.floats(-1.0, 1.0), st.lists(st.floats(0.0, 1.0), min_size=2, max_size=20))
def test_the_way_to_the_default_pose_begins_where_the_robot_is_and_never_turns_back(
    contract: Contract, away: float, parts: list[float]
) -> None:
    default = np.array([joint.default_rad for joint in contract.joints])
    pose = tuple(default + away)
    state = State(Mode.MOVE, 5.0, pose)

    def target(now: float) -> np.ndarray:
        command = states.command(state, now, contract)
        assert command is not None
        return command.target

    np.testing.assert_allclose(target(5.0), pose, atol=1e-12)
    np.testing.assert_allclose(target(5.0 + MOVE_S), default, atol=1e-12)
    left = [np.abs(target(5.0 + MOVE_S * part) - default).max() for part in sorted(parts)]
    assert all(later <= earlier + 1e-12 for earlier, later in itertools.pairwise(left))


def test_commands_of_the_states(contract: Contract) -> None:
    stiffness = [joint.stiffness_nm_rad for joint in contract.joints]
    assert states.command(State(), 0.0, contract) is None
    limp = states.command(State(Mode.ZERO_TORQUE), 0.0, contract)
    damped = states.command(State(Mode.DAMPING), 0.0, contract)
    held = states.command(State(Mode.HOLD), 0.0, contract)
    walking = states.command(State(Mode.WALK), 0.0, contract, np.full(29, 0.3))
    assert limp is not None
    assert damped is not None
    assert held is not None
    assert walking is not None
    assert limp.target.any()  # others can see that somebody commands
    assert not limp.stiffness.any()
    assert not limp.damping.any()
    assert not damped.stiffness.any()
    assert (damped.damping == DAMPING_NMS_RAD).all()
    np.testing.assert_array_equal(held.stiffness, stiffness)
    np.testing.assert_array_equal(held.target, [joint.default_rad for joint in contract.joints])
    np.testing.assert_array_equal(walking.target, 0.3)
    np.testing.assert_array_equal(walking.damping, [joint.damping_nms_rad for joint in contract.joints])
