"""Pellets slide as Coulomb says, are gripped, carried, torn loose, delivered and replaced."""

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import load_arena
from robosim.envs.vector import VectorEnv
from robosim.robot.sheet import GRAVITY
from robosim.world.draws import draw_pellets
from robosim.world.state import Gripper, PelletStatus

FORWARD, BACK, LEFT, STOP = 0, 1, 2, 4
TOP_SPEED = 0.2
GAP = 0.005
NOSE = 0.055
RADIUS = 0.02


def stopping_distance(friction: float, speed: float) -> float:
    return speed**2 / (2.0 * friction * GRAVITY)


@pytest.mark.parametrize("direction", [0.0, 1.0, -2.2])
def test_a_pellet_let_go_at_robot_speed_stops_where_coulomb_says(bench, direction) -> None:
    b = bench([(1.0, 0.6, 0.0)])
    pellet = b.put_pellet((2.2, 1.1))
    pellet.velocity = (TOP_SPEED * math.cos(direction), TOP_SPEED * math.sin(direction))
    pellet.activate()
    b.drive(0.0, 0.0, periods=5)
    distance = math.dist(pellet.position, (2.2, 1.1))
    expected = stopping_distance(b.arena.pellets.friction, TOP_SPEED)
    print(f"slid {1000 * distance:.2f} mm, Coulomb {1000 * expected:.2f} mm ({distance / expected - 1:+.1%})")
    assert distance == pytest.approx(expected, rel=0.10)
    assert pellet.velocity.length < 1e-9


def test_a_pellet_that_a_robot_pushed_stops_where_coulomb_says(bench) -> None:
    """The robot stops within a substep's traction; the pellet goes on alone."""
    b = bench([(1.0, 1.1, 0.0)], robot={"traction": 5.0, "friction": 0.0}, pellets={"mass": 0.001})
    pellet = b.put_pellet((1.2, 1.1))
    b.drive(12.5, 12.5, periods=15)
    assert pellet.velocity.x == pytest.approx(TOP_SPEED, rel=0.02)
    start = pellet.position.x
    b.drive(0.0, 0.0, periods=5)
    distance = pellet.position.x - start
    expected = stopping_distance(b.arena.pellets.friction, TOP_SPEED)
    print(
        f"slid {1000 * distance:.2f} mm after a push, Coulomb {1000 * expected:.2f} mm "
        f"({distance / expected - 1:+.1%})"
    )
    assert distance == pytest.approx(expected, rel=0.10)


def test_twice_as_fast_goes_four_times_as_far(bench) -> None:
    b = bench([(1.0, 0.6, 0.0)])
    distances = []
    for speed in (0.2, 0.4, 0.8):
        pellet = b.put_pellet((1.4, 1.1))
        pellet.velocity = (speed, 0.0)
        pellet.activate()
        b.drive(0.0, 0.0, periods=10)
        distances.append(pellet.position.x - 1.4)
    print("stopping distances of 0.2, 0.4, 0.8 m/s:", [f"{1000 * distance:.1f} mm" for distance in distances])
    for distance, speed in zip(distances, (0.2, 0.4, 0.8), strict=True):
        assert distance == pytest.approx(stopping_distance(b.arena.pellets.friction, speed), rel=0.10)


def test_a_spinning_pellet_comes_to_rest_as_a_disc_on_the_ground_does(bench) -> None:
    """The torque of a disc that rests on all its face is 2/3 mu m g r, so it slows by 4/3 mu g / r."""
    b = bench([(1.0, 0.6, 0.0)])
    for rate in (20.0, 40.0):
        pellet = b.put_pellet((2.2, 1.1))
        pellet.angular_velocity = rate
        pellet.activate()
        start = pellet.angle
        b.drive(0.0, 0.0, periods=10)
        slowing = 4.0 / 3.0 * b.arena.pellets.friction * GRAVITY / RADIUS
        turned, expected = pellet.angle - start, rate**2 / (2.0 * slowing)
        print(
            f"from {rate:.0f} rad/s: turned {turned:.3f} rad, "
            f"expected {expected:.3f} ({turned / expected - 1:+.1%})"
        )
        assert turned == pytest.approx(expected, rel=0.10)
        assert abs(pellet.angular_velocity) < 1e-9


def test_a_pellet_at_rest_stays_and_falls_asleep(bench) -> None:
    b = bench([(1.0, 0.6, 0.0)])
    pellet = b.put_pellet((2.2, 1.1))
    b.drive(0.0, 0.0, periods=20)
    assert tuple(pellet.position) == (2.2, 1.1)
    assert pellet.is_sleeping


def gripped(bench, **tables):
    """A robot at rest that heads along +x and holds a pellet at its nose."""
    b = bench([(2.2, 1.1, 0.0)], **tables)
    b.put_pellet((2.2 + NOSE + RADIUS + GAP, 1.1))
    b.decide([STOP], Gripper.TAKE)
    assert b.world.state.picked.tolist() == [[0]]
    assert b.world.state.held.tolist() == [[0]]
    assert b.world.state.pellet_status.tolist() == [[PelletStatus.HELD]]
    return b


def test_a_gripper_takes_what_is_within_its_reach_and_nothing_else(bench) -> None:
    """Within reach: its edge at most `gripper_reach` from the nose."""
    reach = 0.04
    for place, taken in [
        ((NOSE + RADIUS + reach - 1e-6, 0.0), True),
        ((NOSE + RADIUS + reach + 1e-6, 0.0), False),
        ((NOSE + 0.036, 0.048 - 1e-6), True),
        ((NOSE + 0.036, 0.048 + 1e-6), False),
        ((-NOSE - RADIUS - 1e-3, 0.0), False),
        ((0.0, NOSE + RADIUS + 1e-3), False),
    ]:
        b = bench([(2.2, 1.1, 0.0)])
        b.put_pellet((2.2 + place[0], 1.1 + place[1]))
        b.decide([STOP], Gripper.KEEP)
        assert b.world.state.held.tolist() == [[-1]]
        b.decide([STOP], Gripper.TAKE)
        assert (b.world.state.held[0, 0] == 0) is np.bool_(taken), place


def test_a_held_pellet_is_carried_along_outside_the_robot(bench) -> None:
    """Through a drive, a turn and an arc it stays where it was gripped, within a millimetre."""
    b = gripped(bench)
    worst = 0.0
    for action in [FORWARD] * 4 + [LEFT] * 8 + [FORWARD] * 4 + [BACK] * 4:
        b.decide([action])
        x, y, heading = b.world.state.pose[0, 0]
        apart = b.world.state.pellets[0, 0] - (x, y)
        along = apart @ (math.cos(heading), math.sin(heading))
        across = apart @ (-math.sin(heading), math.cos(heading))
        worst = max(worst, abs(along - NOSE - RADIUS - GAP), abs(across))
        assert math.hypot(*apart) > NOSE + RADIUS - 1e-3
    print(f"carried for 6 s, at most {1000 * worst:.3f} mm out of place")
    assert b.world.state.held.tolist() == [[0]]
    assert worst < 1e-3


def test_a_hard_knock_tears_a_pellet_loose_and_a_gentle_one_does_not(bench) -> None:
    """The grip takes up the energy F * d before the pellet is `TEAR_DISTANCE` = one radius out."""
    sheet = gripped(bench).arena
    critical = math.sqrt(2.0 * sheet.robot.grip_force * RADIUS / sheet.pellets.mass)
    for share in (0.25, 0.5, 0.85, 1.15, 2.0):
        b = gripped(bench)
        pellet = b.pellet()
        pellet.apply_impulse_at_world_point((0.0, share * critical * pellet.mass), pellet.position)
        b.decide([STOP])
        lost = bool(b.world.state.lost[0, 0])
        print(f"knock of {share * critical:.2f} m/s ({share} of the critical {critical:.2f}): lost {lost}")
        assert lost is (share > 1.0)
        assert (b.world.state.held[0, 0] == -1) is np.bool_(lost)
        assert b.world.state.pellet_status[0, 0] == (PelletStatus.LOOSE if lost else PelletStatus.HELD)


def test_a_pull_harder_than_the_grip_tears_a_pellet_loose(bench) -> None:
    for share in (0.8, 1.2):
        b = gripped(bench, robot={"grip_force": 1.0})
        b.push(b.pellet(), (0.0, share * 1.0), 0.2)
        b.decide([STOP])
        print(f"pulled with {share} of the grip force: lost {bool(b.world.state.lost[0, 0])}")
        assert bool(b.world.state.lost[0, 0]) is (share > 1.0)


def test_another_robot_that_drives_into_a_held_pellet_tears_it_loose(bench) -> None:
    b = bench([(2.2, 1.1, 0.0), (2.28, 1.6, -math.pi / 2)], robot={"grip_force": 0.5})
    b.put_pellet((2.2 + NOSE + RADIUS + GAP, 1.1))
    b.decide([STOP, STOP], Gripper.TAKE)
    lost = 0
    for _ in range(12):
        b.decide([STOP, FORWARD])
        lost += int(b.world.state.lost[0, 0])
    assert lost == 1
    assert b.world.state.pellet_status[0, 0] == PelletStatus.LOOSE


def test_a_dropped_pellet_lies_there_and_can_be_taken_again(bench) -> None:
    b = gripped(bench)
    b.decide([STOP], Gripper.OPEN)
    assert b.world.state.held.tolist() == [[-1]]
    assert not b.world.state.lost.any()
    where = b.world.state.pellets[0, 0].copy()
    b.decide([STOP], Gripper.KEEP, times=3)
    assert b.world.state.pellets[0, 0].tolist() == where.tolist()
    b.decide([STOP], Gripper.TAKE)
    assert b.world.state.held.tolist() == [[0]]


def test_two_robots_that_reach_for_one_pellet_do_not_both_get_it(bench) -> None:
    b = bench([(2.2 - 0.08, 1.1, 0.0), (2.2 + 0.08, 1.1, math.pi)])
    b.put_pellet((2.2, 1.1))
    b.decide([STOP, STOP], Gripper.TAKE)
    assert b.world.state.held.tolist() == [[0, -1]]
    b.decide([STOP, STOP], Gripper.TAKE)
    assert b.world.state.held.tolist() == [[0, -1]]
    assert b.world.state.touching.tolist() == [[-1, -1]]


def test_a_delivered_pellet_counts_for_its_last_holder_and_a_fresh_one_lies_in_the_source(bench) -> None:
    b = bench([(0.4, 2.1, 0.0), (2.2, 1.1, 0.0)])
    b.put_pellet((0.4 + NOSE + RADIUS + GAP, 2.1))
    # Set down inside the home it counts at once, before anybody has held it: for the team alone.
    state = b.world.state
    assert state.delivered.tolist() == [1]
    assert state.deliveries.tolist() == [[0, 0]]
    assert state.refilled.tolist() == [1]
    assert state.fresh.tolist() == [[True]]
    in_source = state.pellets[0, 0]
    assert in_source[0] > 3.8
    assert in_source[1] > 2.0

    b.put_pellet((2.2 + NOSE + RADIUS + GAP, 1.1))
    b.decide([STOP, STOP], Gripper.TAKE)
    assert state.held.tolist() == [[-1, 0]]
    b.robot(1).position = (0.5, 2.1)
    b.pellet().position = (0.5 + NOSE + RADIUS + GAP, 2.1)
    b.robot(0).position = (3.0, 0.5)
    b.decide([STOP, STOP], Gripper.OPEN)
    assert state.deliveries.tolist() == [[0, 1]]
    assert state.delivered.tolist() == [2]
    assert state.refilled.tolist() == [2]
    assert state.held.tolist() == [[-1, -1]]


TIGHT = "\n".join(["#" * 8, "#HH#####", "#HH...S#", "#HH#####", "#" * 8])
"""A source of one cell, which a robot that stands in it fills."""


def test_a_delivered_pellet_is_absent_while_the_source_has_no_room(bench) -> None:
    b = bench(
        [(1.3, 0.5, 0.0)],
        drawing=TIGHT,
        robot={"length": 0.18, "width": 0.18, "wheel_base": 0.15},
        pellets={"radius": 0.04},
    )
    b.put_pellet((0.3, 0.3))
    state = b.world.state
    b.decide([STOP], times=5)
    assert state.pellet_status.tolist() == [[PelletStatus.ABSENT]]
    assert (state.delivered - state.refilled).tolist() == [1]
    b.decide([BACK], times=8)
    assert state.pellet_status.tolist() == [[PelletStatus.LOOSE]]
    assert (state.delivered - state.refilled).tolist() == [0]
    assert state.pellets[0, 0, 0] >= 1.2


def test_cohesive_pellets_hold_together_and_others_do_not(bench) -> None:
    """Pulled apart with less than the cohesion a pair moves as one; with more, one comes along alone."""
    for cohesion, together in [(0.0, False), (0.5, True)]:
        b = bench([(1.0, 0.6, 0.0)], pellets={"count": 2, "cohesion": cohesion})
        b.put_pellet((2.2, 1.1), 0)
        b.put_pellet((2.2 + 2 * RADIUS - 1e-4, 1.1), 1)
        b.decide([STOP], times=2)
        b.push(b.pellet(1), (0.2, 0.0), 0.2)
        followed = b.pellet(0).position.x - 2.2
        print(f"cohesion {cohesion} N: the other pellet followed by {1000 * followed:.1f} mm")
        assert (followed > 0.01) is together


def test_a_pellet_cannot_be_pushed_into_a_wall(bench) -> None:
    b = bench([(3.9, 0.6, 0.0)])
    b.put_pellet((4.1, 0.6))
    b.decide([FORWARD], times=10)
    overlap = b.pellet().position.x + RADIUS - 4.2
    squeezed = b.robot().position.x + NOSE - (b.pellet().position.x - RADIUS)
    print(f"pellet squeezed: {1000 * overlap:.3f} mm into the wall, {1000 * squeezed:.3f} mm into the robot")
    assert overlap < 1e-3
    assert squeezed < 1e-3


def test_pellets_begin_evenly_or_densely_toward_one_side() -> None:
    arena = load_arena("paper")
    places = arena.pellet_places
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    lopsided = []
    for gradient in (0.0, 8.0):
        shares = []
        for seed in range(200):
            drawn = places[draw_pellets(arena, np.random.default_rng(seed), gradient)]
            known = {tuple(place) for place in places.tolist()}
            assert len({tuple(place) for place in drawn.tolist()} & known) == arena.pellets.count
            shares.append((drawn > middle).mean(axis=0))
        # As dense on the left as on the right, over many episodes.
        assert np.mean(shares, axis=0) == pytest.approx((places > middle).mean(axis=0), abs=0.05)
        lopsided.append(np.abs(np.array(shares) - 0.5).max(axis=1).mean())
    assert lopsided[0] < 0.15 < 0.25 < lopsided[1]


def test_an_even_beginning_is_the_draw_that_it_always_was() -> None:
    arena = load_arena("paper")
    order = np.random.default_rng(5).permutation(len(arena.pellet_places))
    expected = np.sort(order[: arena.pellets.count])
    assert_array_equal(draw_pellets(arena, np.random.default_rng(5), 0.0), expected)


@pytest.mark.parametrize("start", ['zone = "floor"', "poses = [[3.5, 0.6, 0.0], [3.5, 0.9, 0.5]]"])
def test_no_pellet_lies_under_a_robot_as_an_episode_begins(start) -> None:
    text = load_arena("paper").text + f"\n[start]\n{start}\n"
    arena = load_arena(text)
    robots = min(20, arena.capacity)
    env = VectorEnv(text, robots=robots, num_envs=20, seed=0)
    for _ in range(2):
        env.reset()
        state = env.world.state
        apart = np.hypot(*np.moveaxis(state.pose[:, :, None, :2] - state.pellets[:, None], -1, 0))
        assert apart.min() >= arena.robot.outer_radius + arena.pellets.radius
        assert len(np.unique(state.pellets[0], axis=0)) == arena.pellets.count


def test_where_robots_leave_too_few_places_clear_the_others_are_taken() -> None:
    arena = load_arena("paper")
    clear = np.zeros(len(arena.pellet_places), dtype=np.bool_)
    clear[:3] = True
    drawn = draw_pellets(arena, np.random.default_rng(5), 0.0, clear)
    assert len(set(drawn.tolist())) == arena.pellets.count
    assert {0, 1, 2} <= set(drawn.tolist())
