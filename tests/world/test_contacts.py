"""Contacts name the right bodies, places and times, with impulses that mechanics gives."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.world.contacts import ContactKind, no_contacts, onsets
from robosim.world.state import Gripper

FORWARD, STOP = 0, 4
NOSE, RADIUS = 0.055, 0.02


def rows(contacts) -> list[tuple[int, int, int, float]]:
    return [
        (int(kind), int(a), int(b), round(float(time), 6))
        for kind, a, b, time in zip(contacts.kind, contacts.a, contacts.b, contacts.time, strict=True)
    ]


def test_nobody_near_no_contact(bench) -> None:
    b = bench([(2.2, 1.1, 0.0), (3.0, 1.1, 0.0)])
    b.decide([STOP, FORWARD], times=2)
    assert rows(b.world.contacts) == []
    assert not b.world.state.touched.any()


def test_two_robots_head_on_are_one_row_for_each_control_period(bench) -> None:
    """Pressed against each other they pass the traction; the place is between their middles."""
    b = bench([(1.0, 0.6, 0.0), (2.0, 1.1, math.pi), (1.8, 1.1, 0.0)])
    b.decide([STOP, FORWARD, FORWARD], times=3)
    contacts = b.world.contacts
    assert rows(contacts) == [
        (ContactKind.ROBOT_ROBOT, 1, 2, round(0.6 + 0.1 * period, 6)) for period in (1, 2, 3)
    ]
    force = contacts.impulse / b.arena.timing.substep
    print(f"head-on: {force} N, traction {b.arena.robot.traction_force:.4f} N")
    assert force == pytest.approx(b.arena.robot.traction_force, rel=0.01)
    assert contacts.position == pytest.approx(np.tile([1.9, 1.1], (3, 1)), abs=1e-3)
    assert b.world.state.touched[ContactKind.ROBOT_ROBOT].tolist() == [[False, True, True]]
    assert not b.world.state.touched[ContactKind.ROBOT_WALL].any()


def test_a_blow_passes_the_momentum_that_it_takes_away(bench) -> None:
    """Two robots without drive meet at 2 v: each loses m v in the substep in which they touch."""
    b = bench([(1.8, 1.1, 0.0), (2.0, 1.1, math.pi)], robot={"traction": 0.01})
    for index, sign in enumerate((1.0, -1.0)):
        b.robot(index).velocity = (sign * 0.2, 0.0)
    before = b.robot(0).velocity.x
    impulse = []
    b.world._log.clear()
    for _ in range(60):
        b.space.step(b.arena.timing.substep)
        for arbiter in _impulses(b):
            impulse.append(arbiter)
    lost = b.arena.robot.mass * (before - b.robot(0).velocity.x)
    print(f"momentum lost {lost:.4f} N s, largest impulse of the contact {max(impulse):.4f} N s")
    assert b.robot(0).velocity.x == pytest.approx(0.0, abs=5e-3)
    assert max(impulse) == pytest.approx(b.arena.robot.mass * 0.2, rel=0.15)


def _impulses(b) -> list[float]:
    found: list[float] = []
    b.robot(0).each_arbiter(lambda arbiter: found.append(arbiter.total_impulse.length))
    return found


def test_a_wall_is_minus_one_and_so_is_touched(bench) -> None:
    b = bench([(4.2 - NOSE - 0.01, 1.1, 0.0)])
    b.decide([FORWARD], times=2)
    assert rows(b.world.contacts) == [
        (ContactKind.ROBOT_WALL, 0, -1, round(0.3 + 0.1 * k, 6)) for k in (1, 2, 3)
    ]
    assert b.world.contacts.position[:, 0] == pytest.approx(4.2, abs=1e-3)
    assert b.world.state.touched[:, 0, 0].tolist() == [False, True, False]


def test_a_corner_gives_two_rows_of_walls(bench) -> None:
    b = bench([(4.13, 0.27, -math.pi / 4)])
    b.decide([FORWARD], times=2)
    assert rows(b.world.contacts) == [
        (ContactKind.ROBOT_WALL, 0, -1, t) for t in (0.4, 0.4, 0.5, 0.5, 0.6, 0.6)
    ]


def test_a_pushed_pellet_is_named_and_pushed_with_its_friction(bench) -> None:
    b = bench([(1.4, 1.1, 0.0)], pellets={"count": 3})
    b.put_pellet((1.4 + NOSE + RADIUS + 0.01, 1.1), index=2)
    b.decide([FORWARD], times=3)
    contacts = b.world.contacts
    assert rows(contacts) == [(ContactKind.ROBOT_PELLET, 0, 2, round(0.6 + 0.1 * k, 6)) for k in (1, 2, 3)]
    sheet = b.arena.pellets
    force = contacts.impulse / b.arena.timing.substep
    print(f"pushing a pellet: {force} N, its friction {sheet.friction * sheet.mass * 9.81:.5f} N")
    assert force == pytest.approx(sheet.friction * sheet.mass * 9.81, rel=0.05)
    assert b.world.state.touched[:, 0, 0].tolist() == [False, False, True]


def test_what_touches_a_held_pellet_touches_its_robot(bench) -> None:
    """Robot 0 holds; robot 1 drives into the pellet and never reaches the robot itself."""
    b = bench([(2.2, 1.1, 0.0), (2.2 + 0.24, 1.1, math.pi)])
    b.put_pellet((2.2 + NOSE + RADIUS + 0.002, 1.1))
    b.decide([STOP, STOP], Gripper.TAKE)
    assert b.world.state.held.tolist() == [[0, -1]]
    assert rows(b.world.contacts) == []
    b.decide([STOP, FORWARD], times=2)
    assert math.dist(b.robot(0).position, b.robot(1).position) > 2 * NOSE + 0.03
    assert {(kind, a, other) for kind, a, other, _ in rows(b.world.contacts)} == {
        (ContactKind.ROBOT_ROBOT, 0, 1)
    }
    assert b.world.state.touched[ContactKind.ROBOT_ROBOT].tolist() == [[True, True]]


def test_a_held_pellet_at_a_wall_is_its_robots_contact_with_a_wall(bench) -> None:
    b = bench([(4.2 - NOSE - 2 * RADIUS - 0.03, 1.1, 0.0)])
    b.put_pellet((4.2 - RADIUS - 0.025, 1.1))
    b.decide([STOP], Gripper.TAKE)
    assert b.world.state.held.tolist() == [[0]]
    b.decide([FORWARD], times=2)
    assert {(kind, a, other) for kind, a, other, _ in rows(b.world.contacts)} == {
        (ContactKind.ROBOT_WALL, 0, -1)
    }


def test_pellets_that_touch_each_other_or_a_wall_concern_nobody(bench) -> None:
    b = bench([(1.0, 0.6, 0.0)], pellets={"count": 2})
    b.put_pellet((4.2 - RADIUS + 1e-3, 1.1), 0)
    b.put_pellet((4.2 - 3 * RADIUS + 2e-3, 1.1), 1)
    b.decide([STOP], times=2)
    assert rows(b.world.contacts) == []


def test_a_short_touch_marks_both_robots_and_presses_nobody(bench) -> None:
    """Two that part again within a control period have touched, and are over when contacts are listed."""
    b = bench([(1.8, 1.1, 0.0), (2.0, 1.1, 0.0)])
    b.robot(0).position = (2.0 - 2 * NOSE - 0.001, 1.1)
    b.robot(0).velocity = (0.15, 0.0)
    b.decide([STOP, STOP])
    assert b.world.state.touched[ContactKind.ROBOT_ROBOT].tolist() == [[True, True]]
    assert rows(b.world.contacts) == []
    b.robot(1).position = (2.6, 1.1)
    b.decide([STOP, STOP], times=2)
    assert not b.world.state.touched.any()


def test_contacts_come_in_an_order_of_their_own() -> None:
    """By environment, time, kind and bodies: nothing of memory in it."""
    env = VectorEnv("single-lane", robots=8, num_envs=3, seed=5, episode_steps=10**6)
    controller = LanesController()
    observation = env.reset()
    controller.reset(env)
    seen = 0
    rng = np.random.default_rng(0)
    for _ in range(300):
        actions = controller.act(env, observation)
        actions = np.where(rng.random(actions.shape) < 0.2, rng.integers(0, 5, actions.shape), actions)
        observation = env.step(actions).observation
        contacts = env.world.contacts
        key = list(zip(contacts.env, np.round(contacts.time, 6), contacts.kind, strict=True))
        assert key == sorted(key)
        pairs = contacts.kind == ContactKind.ROBOT_ROBOT
        assert (contacts.a[pairs] != contacts.b[pairs]).all()
        assert (contacts.impulse > 0.0).all()
        assert ((contacts.b == -1) == (contacts.kind == ContactKind.ROBOT_WALL)).all()
        start, end = env.frame().time - 0.3, env.frame().time
        assert ((contacts.time > start) & (contacts.time <= end + 1e-9)).all()
        flat = np.zeros_like(env.world.state.touched)
        for kind, e, a, other in zip(contacts.kind, contacts.env, contacts.a, contacts.b, strict=True):
            flat[kind, e, a] = True
            if kind == ContactKind.ROBOT_ROBOT:
                flat[kind, e, other] = True
        assert (flat <= env.world.state.touched).all()
        assert sum(len(contacts.of_env(e).kind) for e in range(3)) == len(contacts.kind)
        seen += len(contacts.kind)
    assert seen > 1000
    assert len(no_contacts().kind) == 0


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 40)), max_size=20).map(
        lambda events: sorted(events, key=lambda e: e[1])
    ),
    st.integers(0, 20),
)
def test_onsets_of_chunks_are_those_of_a_plain_loop(events, cut):
    expected, last = [], {}
    for pair, time in events:
        expected.append(pair not in last or time - last[pair] > 5)
        last[pair] = time
    pairs = np.array([pair for pair, _ in events], dtype=np.int64)
    times = np.array([float(time) for _, time in events])
    remembered: dict[int, float] = {}
    found = [
        opens
        for part in (slice(None, cut), slice(cut, None))
        for opens in onsets(pairs[part], times[part], remembered, 5.0).tolist()
    ]
    assert found == expected
    assert remembered == last


@pytest.mark.parametrize("substeps", [1, 2, 3])
def test_a_touch_ends_with_the_contact_however_few_substeps_a_control_period_has(substeps) -> None:
    period = 0.025 * substeps
    text = load_arena("paper").text.replace(
        "[pellets]", "[start]\nposes = [[1.5, 0.675, 0.0], [1.615, 0.675, 3.14159265]]\n\n[pellets]"
    )
    text += f"\n[timing]\nsubsteps = {substeps}\ncontrol_period = {period}\ndecision_period = {period}\n"
    env = VectorEnv(text, robots=2, actions="wheels")
    env.reset()
    state, touches = env.world.state, 0
    for decision in range(40):
        touched = bool(state.touched[0].any())
        apart = float(np.hypot(*(state.pose[0, 0, :2] - state.pose[0, 1, :2])))
        touches += touched
        # What was in touch when the period began may have come apart within it.
        assert not touched or apart < env.arena.robot.length + 2.0 * 0.2 * period + 1e-3
        env.step([[0, 0]] if decision < 20 else [[1, 1]])
    assert touches > 0
