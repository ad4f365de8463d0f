"""The grid world: its time, its moves, its pellets, and what it shares with the physical world."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import load_arena, parse_arena
from robosim.arena.model import Zone
from robosim.arena.schema import TimingSection
from robosim.discretise.modes import Mode
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.world.factory import make_world
from robosim.world.grid.layout import cells_at, grid_arena
from robosim.world.state import ABSENT, HELD, LOOSE, Gripper
from tests.strategies.arenas import OF_EQUALS
from tests.world.grid.rooms import (
    BACK,
    CELL,
    EAST,
    FORWARD,
    LEFT,
    NORTH,
    RIGHT,
    ROOM,
    SOUTH,
    STOP,
    WEST,
    Bench,
    room,
)


def test_it_needs_no_physics() -> None:
    code = (
        "import sys; from robosim.arena import load_arena; from robosim.world.factory import make_world; "
        "from robosim.envs.vector import VectorEnv; env = VectorEnv('paper', robots=2, world='grid'); "
        "env.reset(); env.step([[0, 1]]); assert 'pymunk' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", OF_EQUALS)
def test_a_decision_lasts_as_long_as_a_cell_at_top_speed(name: str) -> None:
    arena = load_arena(name)
    world = make_world("grid", arena, 2, 1)
    timing = world.arena.timing
    assert timing.decision_period == pytest.approx(arena.cell_size / arena.robot.top_speed)
    assert timing.control_steps * timing.control_period == pytest.approx(timing.decision_period)
    assert timing.episode_steps == arena.timing.episode_steps
    assert (world.travel, world.on_cells) == (arena.cell_size, True)
    TimingSection(**{field: getattr(timing, field) for field in TimingSection.model_fields})
    assert world.arena.text == arena.text


def test_control_periods_of_long_decisions_stay_in_range() -> None:
    slow = parse_arena(load_arena("paper").text + "\n[robot]\nmax_wheel_speed = 3.0\n", "slow.toml")
    timing = grid_arena(slow).timing
    assert timing.decision_period == pytest.approx(3.125)
    assert (timing.control_steps, timing.control_period) == (4, pytest.approx(0.78125))


def test_a_decision_that_no_arena_file_allows_is_one_sentence() -> None:
    slow = parse_arena(
        load_arena("paper").text + "\n[robot]\nmax_wheel_speed = 0.5\nwheel_radius = 0.01\n", "slow.toml"
    )
    with pytest.raises(InputError) as refusal:
        make_world("grid", slow, 1, 1)
    assert str(refusal.value) == (
        "arena 'paper': cell_size over the robot's top speed, a decision in the grid, is 30 s; "
        "allowed are numbers from 0.01 to 10 s."
    )


@pytest.mark.parametrize("name", OF_EQUALS)
def test_robots_start_one_a_cell_in_the_starting_zone_and_pellets_in_the_source(name: str) -> None:
    arena = load_arena(name)
    capacity = grid_arena(arena).capacity
    world = make_world("grid", arena, capacity, 3)
    world.reset([np.random.SeedSequence(seed) for seed in range(3)])
    cells = cells_at(world.arena, world.state.pose[..., :2])
    assert all(len(set(row)) == capacity for row in cells.tolist())
    assert (arena.zones.ravel()[cells] == Zone.HOME).all()
    assert (arena.zones.ravel()[cells_at(world.arena, world.state.pellets)] == Zone.SOURCE).all()
    assert len({tuple(row) for row in cells.tolist()}) == 3
    # What is allowed is the grid's own room, also of a team that is too large for the physics.
    for robots in (capacity + 1, 500):
        with pytest.raises(InputError) as refusal:
            VectorEnv(arena, robots=robots, world="grid")
        assert str(refusal.value) == (
            f"robots is {robots}, but must be a whole number from 1 to {capacity}, "
            f"the room in arena {name!r} in the grid, one robot a cell."
        )


def test_given_poses_become_cells_and_quarter_turns_and_the_first_one_has_the_cell() -> None:
    arena = parse_arena(
        f'name = "room"\ncell_size = {CELL}\nmap = """{ROOM}"""\n'
        "[pellets]\ncount = 1\n[robot]\nlength = 0.05\nwidth = 0.05\n"
        "[start]\nposes = [[0.33, 0.8, 1.2], [0.41, 0.8, 0.0], [0.99, 0.77, -3.0]]\n",
        "room.toml",
    )
    world = make_world("grid", arena, 2, 1)
    assert (arena.capacity, world.arena.capacity) == (3, 2)
    world.reset([np.random.SeedSequence(0)])
    assert world.state.pose[0].tolist() == [
        pytest.approx([2.5 * CELL, 5.5 * CELL, 0.5 * np.pi]),
        pytest.approx([6.5 * CELL, 5.5 * CELL, -np.pi]),
    ]


def test_cardinal_moves_go_where_they_say_and_turn_the_heading() -> None:
    bench = Bench(room([(4, 3)]))
    for action, cell, heading in (
        (NORTH, (4, 4), 0.5 * np.pi), (WEST, (3, 4), -np.pi), (SOUTH, (3, 3), -0.5 * np.pi),
        (EAST, (4, 3), 0.0), (STOP, (4, 3), 0.0),
    ):  # fmt: skip
        assert bench.decide(action) == [cell]
        assert bench.state.pose[0, 0, 2] == heading
    assert not bench.state.touched.any()


def test_wheels_go_along_the_heading_and_spin_by_right_angles() -> None:
    bench = Bench(room([(4, 3)]), actions="wheels")
    for action, cell, heading in (
        (FORWARD, (5, 3), 0.0), (LEFT, (5, 3), 0.5 * np.pi), (FORWARD, (5, 4), 0.5 * np.pi),
        (BACK, (5, 3), 0.5 * np.pi), (LEFT, (5, 3), -np.pi), (FORWARD, (4, 3), -np.pi),
        (RIGHT, (4, 3), 0.5 * np.pi), (RIGHT, (4, 3), 0.0), (RIGHT, (4, 3), -0.5 * np.pi),
        (BACK, (4, 4), -0.5 * np.pi), (STOP, (4, 4), -0.5 * np.pi),
    ):  # fmt: skip
        assert bench.decide(action) == [cell]
        assert bench.state.pose[0, 0, 2] == heading


def test_nine_wheel_actions_are_refused() -> None:
    with pytest.raises(InputError) as refusal:
        make_world("grid", load_arena("paper"), 1, 1, "wheels-9")
    assert str(refusal.value) == (
        'actions is "wheels-9", but must be "cardinal" or "wheels" in the grid, which turns by quarters.'
    )


def test_velocities_are_those_of_the_decision() -> None:
    bench = Bench(room([(4, 3)]))
    bench.decide(NORTH)
    assert bench.state.velocity[0, 0].tolist() == pytest.approx([0.0, 0.2, 0.5 * np.pi / 0.75])
    bench.decide(STOP)
    assert bench.state.velocity[0, 0].tolist() == [0.0, 0.0, 0.0]


def test_a_wall_refuses_and_is_touched_and_the_heading_stays() -> None:
    bench = Bench(room([(4, 5)]))
    assert bench.decide(NORTH) == [(4, 5)]
    assert bench.state.touched[:, 0, 0].tolist() == [False, True, False]
    assert bench.state.pose[0, 0, 2] == 0.0
    contacts = bench.world.contacts
    assert (contacts.kind.tolist(), contacts.a.tolist(), contacts.b.tolist()) == ([1], [0], [-1])
    assert contacts.position[0].tolist() == pytest.approx([4.5 * CELL, 6.0 * CELL])


def test_refused_is_who_has_not_moved_since() -> None:
    bench = Bench(room([(4, 3), (5, 3)]))
    for actions, refused in (
        ((EAST, STOP), [True, False]), ((STOP, STOP), [True, False]), ((STOP, NORTH), [True, False]),
        ((EAST, STOP), [False, False]), ((STOP, STOP), [False, False]),
    ):  # fmt: skip
        bench.decide(*actions)
        assert bench.state.refused[0].tolist() == refused
    assert not bench.state.touched.any()


@pytest.mark.parametrize("toward", ["robot", "wall"])
def test_the_mode_is_collision_until_a_free_cell_is_chosen(toward: str) -> None:
    env = VectorEnv(room([(4, 5), (5, 5)]), robots=2, world="grid")
    env.reset()
    into = EAST if toward == "robot" else NORTH
    rewards = []
    for action, shown in (
        (into, Mode.COLLISION), (STOP, Mode.COLLISION), (into, Mode.COLLISION), (SOUTH, Mode.GOING_TO_DIG)
    ):  # fmt: skip
        rewards.append(float(env.step([[action, STOP]]).reward[0, 0]))
        assert env.dec_pomdp.shown_mode[0].tolist() == [shown, Mode.GOING_TO_DIG]
    # The paper fines running into a robot, each time, and neither walls nor standing.
    fine = -0.4 if toward == "robot" else 0.0
    assert rewards[:3] == pytest.approx([fine, 0.0, fine])
    assert env.dec_pomdp.collisions[0].tolist() == [2 if toward == "robot" else 0, 0]


def test_a_pellet_is_taken_in_its_cell_carried_home_delivered_and_replaced() -> None:
    """By the modes alone: the robot walks from the source to the home and back."""
    env = VectorEnv(room([(5, 2)], pellets=4), robots=1, world="grid")
    env.reset()
    state, seen = env.world.state, []

    def walk(action: int) -> None:
        before = int(state.held[0, 0])
        env.step([[action]])
        seen.append((Mode(int(env.dec_pomdp.shown_mode[0, 0])), int(state.held[0, 0]), before))

    for _ in range(60):
        if state.held[0, 0] >= 0:
            break
        loose = state.pellets[0] // CELL
        here = state.pose[0, 0, :2] // CELL
        step = (loose[np.abs(loose - here).sum(axis=1).argmin()] - here).tolist()
        walk(EAST if step[0] > 0 else WEST if step[0] < 0 else NORTH if step[1] > 0
             else SOUTH if step[1] < 0 else STOP)  # fmt: skip
    pellet = int(state.held[0, 0])
    assert pellet >= 0
    assert state.picked[0, 0] == pellet
    assert state.pellet_status[0, pellet] == HELD
    assert state.touching[0, 0] == -1
    assert seen[-1][0] == Mode.EXIT_DIGGING
    for action in (NORTH, NORTH, NORTH, WEST, WEST, WEST, WEST, WEST):
        walk(action)
        if state.delivered[0]:
            break
        # It goes where the robot goes, within its cell.
        if state.held[0, 0] >= 0:
            assert (state.pellets[0, pellet] // CELL).tolist() == (state.pose[0, 0, :2] // CELL).tolist()
            assert state.pellet_status[0, pellet] == HELD
    assert (state.delivered[0], state.deliveries[0, 0], state.refilled[0]) == (1, 1, 1)
    assert state.fresh[0].tolist() == [one == pellet for one in range(4)]
    assert (state.pellet_status[0] == LOOSE).all()
    assert env.arena.zones.ravel()[cells_at(env.arena, state.pellets[0, pellet])] == Zone.SOURCE
    assert env.delivered.tolist() == [[1]]
    env.step([[STOP]])
    assert (state.deliveries[0, 0], int(state.fresh.sum())) == (0, 0)


def test_a_pellet_that_is_let_go_elsewhere_lies_there_and_can_be_taken_again() -> None:
    bench = Bench(room([(6, 1)], pellets=30))
    bench.decide(STOP, gripper=Gripper.TAKE)
    pellet = int(bench.state.held[0, 0])
    assert pellet >= 0
    for action in (WEST, WEST):
        bench.decide(action)
    bench.decide(STOP, gripper=Gripper.OPEN)
    assert (bench.state.held[0, 0], bench.state.touching[0, 0]) == (-1, pellet)
    assert bench.state.pellet_status[0, pellet] == LOOSE
    bench.decide(WEST, gripper=Gripper.TAKE)
    assert bench.state.touching[0, 0] == -1
    bench.decide(EAST, gripper=Gripper.TAKE)
    assert bench.state.held[0, 0] == pellet
    assert (bench.state.delivered[0], bench.state.lost.any()) == (0, False)


def test_without_room_in_the_source_pellets_wait_and_come_back_when_there_is_some() -> None:
    """A source of one cell, in which a robot stands while another delivers next to it."""
    drawing = "\n######\n#HHS.#\n######\n"
    bench = Bench(room([(3, 1)], drawing, pellets=1))
    bench.decide(STOP, gripper=Gripper.TAKE)
    assert bench.state.held[0, 0] == 0
    bench.decide(WEST, gripper=Gripper.OPEN)
    assert (bench.state.delivered[0], bench.state.refilled[0]) == (1, 1)
    bench = Bench(room([(3, 1), (4, 1)], drawing, pellets=1))
    bench.decide(STOP, STOP, gripper=Gripper.TAKE)
    bench.decide(WEST, WEST)
    bench.decide(STOP, STOP, gripper=Gripper.OPEN)
    assert (bench.state.delivered[0], bench.state.refilled[0]) == (1, 0)
    assert bench.state.pellet_status[0].tolist() == [ABSENT]
    bench.decide(STOP, EAST)
    assert (bench.state.delivered[0], bench.state.refilled[0]) == (1, 1)


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_the_arena_of_a_grid_environment_makes_the_environment_that_its_text_makes(world: str) -> None:
    arena = VectorEnv("paper", robots=2, world="grid").arena
    env, plain = (VectorEnv(one, robots=2, world=world) for one in (arena, "paper"))
    assert env.arena.timing == plain.arena.timing
    assert_array_equal(env.arena.start_places, plain.arena.start_places)
    assert_array_equal(env.reset(), plain.reset())


def test_an_arena_without_pellets_runs() -> None:
    full = load_arena("paper")
    empty = replace(full, pellets=replace(full.pellets, count=0))
    env = VectorEnv(empty, robots=3, world="grid")
    env.reset()
    for _ in range(30):
        observation = env.step([[EAST, EAST, WEST]]).observation
    assert np.isfinite(observation).all()


def test_fresh_pellets_go_to_every_free_place_alike() -> None:
    """One pellet, delivered again and again: each of the source's places gets its share."""
    drawing = "\n######\n#HSS.#\n######\n"
    bench = Bench(room([(2, 1)], drawing, pellets=1), envs=3000)
    bench.decide(STOP, gripper=Gripper.TAKE)
    taken = bench.state.held[:, 0] >= 0
    bench.decide(WEST, gripper=Gripper.OPEN)
    fresh = bench.state.pellets[taken, 0]
    places, counts = np.unique(fresh.round(6), axis=0, return_counts=True)
    assert len(places) == len(bench.world.arena.pellet_places)
    assert_array_equal(bench.state.refilled, taken)
    expected = taken.sum() / len(places)
    print("places:", len(places), "counts:", counts)
    assert np.abs(counts - expected).max() < 4.5 * np.sqrt(expected)
