"""Drivers make wheel speeds of actions: cardinal ones lead to the neighbouring cell, stop for nobody."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from robosim.robot.drivers import (
    ACTION_NAMES,
    CARDINAL_STEPS,
    STOP,
    Cardinal,
    CardinalDriver,
    DistanceKeeper,
    Wheels,
    WheelsDriver,
    make_driver,
)
from robosim.robot.kinematics import body_twist
from robosim.robot.sheet import RobotSheet

SHEET = RobotSheet()
CELL, PERIOD = 0.15, 0.1
FREE = np.ones((40, 40), dtype=np.bool_)


def drive(driver, pose: np.ndarray, actions: list[int], decisions: int = 1) -> np.ndarray:
    """Integrate the wheels' motion without any world; returns the pose [1, robots, 3]."""
    pose = pose.copy()
    for _ in range(decisions):
        driver.begin(pose, np.array([actions]))
        for _ in range(3):
            speed, rate = body_twist(SHEET, driver.wheel_speeds(pose))
            pose[..., 0] += PERIOD * speed * np.cos(pose[..., 2] + 0.5 * PERIOD * rate)
            pose[..., 1] += PERIOD * speed * np.sin(pose[..., 2] + 0.5 * PERIOD * rate)
            pose[..., 2] += PERIOD * rate
    return pose


def cardinal(pose: np.ndarray) -> CardinalDriver:
    driver = CardinalDriver(SHEET, FREE, CELL, PERIOD, 3 * PERIOD)
    driver.reset(pose)
    return driver


@pytest.mark.parametrize("action", [Cardinal.NORTH, Cardinal.SOUTH, Cardinal.WEST, Cardinal.EAST])
@pytest.mark.parametrize("offset", [-0.06, -0.01, 0.01, 0.05])
def test_with_a_wall_ahead_a_robot_closes_up_to_the_middle_of_its_cell(action, offset) -> None:
    step = CARDINAL_STEPS[action]
    walled = FREE.copy()
    walled[10 + step[1], 10 + step[0]] = False
    start = 10.5 * CELL + offset * step
    pose = np.array([[[start[0], start[1], math.atan2(step[1], step[0])]]])
    driver = CardinalDriver(SHEET, walled, CELL, PERIOD, 3 * PERIOD)
    driver.reset(pose)
    end = drive(driver, pose, [action], decisions=6)[0, 0]
    beyond = (end[:2] - 10.5 * CELL) @ step
    print(f"{action.name} from {1000 * offset:.0f} mm: ends {1000 * beyond:.1f} mm beyond the middle")
    assert max(offset, -0.041) - 1e-9 <= beyond <= max(offset, 0.021) + 1e-9


def test_wheels_actions_are_wheel_speeds_held() -> None:
    driver = WheelsDriver(SHEET)
    pose = np.zeros((1, 9, 3))
    driver.begin(pose, np.arange(9)[None])
    speed, rate = body_twist(SHEET, driver.wheel_speeds(pose))
    top, turn = SHEET.top_speed, SHEET.top_turn_rate
    assert speed[0] == pytest.approx([top, -top, 0.0, 0.0, 0.0, *2 * [0.75 * top], *2 * [-0.75 * top]])
    assert rate[0] == pytest.approx(
        [0.0, 0.0, turn, -turn, 0.0, 0.25 * turn, -0.25 * turn, -0.25 * turn, 0.25 * turn]
    )


@pytest.mark.parametrize("name", ["bear left", "bear right", "back left", "back right"])
def test_arcs_lead_to_the_side_that_their_names_say(name: str) -> None:
    pose = np.zeros((1, 1, 3))
    end = drive(WheelsDriver(SHEET), pose, [ACTION_NAMES["wheels-9"].index(name)], decisions=3)[0, 0]
    assert np.sign(end[0]) == (1.0 if name.startswith("bear") else -1.0)
    assert np.sign(end[1]) == (1.0 if name.endswith("left") else -1.0)


def test_actions_are_numbered_as_they_are_named() -> None:
    for kind, members in (("cardinal", Cardinal), ("wheels", list(Wheels)[:5]), ("wheels-9", Wheels)):
        assert ACTION_NAMES[kind] == tuple(one.name.lower().replace("_", " ") for one in members)
        assert [int(one) for one in members] == list(range(len(members)))
    assert STOP == Cardinal.STOP == Wheels.STOP


@pytest.mark.parametrize("action", [Cardinal.NORTH, Cardinal.SOUTH, Cardinal.WEST, Cardinal.EAST])
@pytest.mark.parametrize("heading", [0.0, 1.5, 3.1, -2.0])
def test_a_cardinal_action_leads_along_the_middle_of_the_row_or_column(action, heading) -> None:
    """From off the middle of a cell, whatever the heading, the robot soon runs along the cells' middle."""
    pose = np.array([[[10.5 * CELL + 0.04, 10.5 * CELL - 0.03, heading]]])
    end = drive(cardinal(pose), pose, [action], decisions=12)[0, 0]
    step = CARDINAL_STEPS[action]
    across = (end[:2] - 10.5 * CELL) @ np.abs(step[::-1])
    along = (end[:2] - 10.5 * CELL) @ step
    print(
        f"{action.name} from heading {heading}: {along / CELL:.2f} cells on, "
        f"{1000 * across:.1f} mm off the middle"
    )
    assert abs(across) < 0.01
    assert along > 2.0 * CELL
    assert math.cos(end[2] - math.atan2(step[1], step[0])) > 0.99


def test_at_top_speed_once_it_faces_the_way() -> None:
    pose = np.array([[[0.075, 0.075, 0.0]]])
    end = drive(cardinal(pose), pose, [Cardinal.EAST], decisions=10)
    assert end[0, 0, 0] - 0.075 == pytest.approx(10 * 0.3 * SHEET.top_speed, rel=0.02)


def test_stop_stops() -> None:
    pose = np.array([[[0.3, 0.4, 0.5], [0.8, 0.8, -1.0]]])
    driver = cardinal(pose)
    driver.begin(pose, np.array([[Cardinal.STOP, Cardinal.EAST]]))
    wheels = driver.wheel_speeds(pose)
    assert (wheels[0, 0] == 0.0).all()
    assert (wheels[0, 1] != 0.0).any()


def test_commands_are_within_the_data_sheet_but_for_turns_that_are_jammed() -> None:
    """Backing out while turning asks for half more than the wheels can, which the world cuts off."""
    rng = np.random.default_rng(0)
    pose = np.concatenate(
        [rng.uniform(0.0, 3.0, (4, 100, 2)), rng.uniform(-np.pi, np.pi, (4, 100, 1))], axis=2
    )
    driver = CardinalDriver(SHEET, FREE, CELL, PERIOD, 3 * PERIOD)
    driver.reset(pose)
    for decision in range(10):
        driver.begin(pose, rng.integers(0, 5, (4, 100)))
        wheels = driver.wheel_speeds(pose)
        assert np.isfinite(wheels).all()
        most = 1.0 if decision == 0 else 1.5
        assert np.abs(wheels).max() <= most * SHEET.max_wheel_speed * (1 + 1e-12)
        pose[..., 2] = rng.uniform(-np.pi, np.pi, (4, 100))


def test_mirror_images_are_driven_as_mirror_images() -> None:
    """North and South exchanged, left and right wheel exchanged."""
    rng = np.random.default_rng(1)
    pose = np.array(
        [
            [
                [10.5 * CELL + x, 10.5 * CELL + y, h]
                for x, y, h in rng.uniform(-0.07, 0.07, (20, 3)) * [1, 1, 40]
            ]
        ]
    )
    mirrored = pose * [1.0, -1.0, -1.0] + [0.0, 21 * CELL, 0.0]
    exchanged = np.array([1, 0, 2, 3, 4])
    for action in range(5):
        one, other = cardinal(pose), cardinal(mirrored)
        one.begin(pose, np.full((1, 20), action))
        other.begin(mirrored, np.full((1, 20), exchanged[action]))
        assert one.wheel_speeds(pose) == pytest.approx(other.wheel_speeds(mirrored)[..., ::-1], abs=1e-9)


def test_a_jammed_turn_is_backed_out_of_and_a_free_one_is_not() -> None:
    """A robot that should turn and does not is sent back, then forward, and so on until it turns."""
    pose = np.array([[[10.5 * CELL, 10.5 * CELL, 0.0]]])
    driver = cardinal(pose)
    speeds = []
    for _ in range(4):
        driver.begin(pose, np.array([[Cardinal.WEST]]))
        for _ in range(3):
            wheels = driver.wheel_speeds(pose)
        speeds.append(float(body_twist(SHEET, wheels)[0][0, 0]))
    assert speeds[0] == pytest.approx(0.0, abs=1e-12)
    assert speeds[1] < 0.0 < speeds[2]
    assert speeds[3] < 0.0
    turned = drive(cardinal(pose), pose, [Cardinal.WEST], decisions=3)
    assert math.cos(turned[0, 0, 2]) < -0.9
    assert turned[0, 0, :2] == pytest.approx(pose[0, 0, :2], abs=0.03)


def test_reset_forgets_what_was() -> None:
    pose = np.array([[[1.0, 1.0, 0.0]], [[1.0, 1.0, 0.0]]])
    used, fresh = (CardinalDriver(SHEET, FREE, CELL, PERIOD, 3 * PERIOD) for _ in range(2))
    used.reset(pose)
    fresh.reset(pose)
    west = np.full((2, 1), Cardinal.WEST)
    for _ in range(2):
        used.begin(pose, west)
        used.wheel_speeds(pose)
    used.begin(pose, west)
    jammed, _ = body_twist(SHEET, used.wheel_speeds(pose))
    assert (np.abs(jammed) > 1e-3).all()
    used.reset(pose)
    for driver in (used, fresh):
        driver.begin(pose, west)
    assert_array_equal(used.wheel_speeds(pose), fresh.wheel_speeds(pose))


def test_each_kind_of_action_has_its_driver() -> None:
    assert isinstance(make_driver("cardinal", SHEET, FREE, CELL, PERIOD, 3 * PERIOD), CardinalDriver)
    for kind in ("wheels", "wheels-9"):
        assert isinstance(make_driver(kind, SHEET, FREE, CELL, PERIOD, 3 * PERIOD), WheelsDriver)
    keeper = make_driver("cardinal", SHEET, FREE, CELL, PERIOD, 3 * PERIOD, keep_distance=0.2)
    assert isinstance(keeper, DistanceKeeper)


def apart(pose: np.ndarray) -> float:
    """The least distance between two robots of any environment."""
    x, y = pose[..., 0], pose[..., 1]
    distance = np.hypot(x[:, :, None] - x[:, None], y[:, :, None] - y[:, None])
    return float(distance[:, ~np.eye(pose.shape[1], dtype=bool)].min())


@given(st.integers(0, 2**32 - 1), st.sampled_from(["cardinal", "wheels", "wheels-9"]), st.floats(0.12, 0.3))
def test_whatever_is_commanded_centres_keep_their_distance(seed: int, kind, distance: float) -> None:
    rng = np.random.default_rng(seed)
    grid = np.array([(x, y) for x in range(3) for y in range(2)])
    pose = np.concatenate([3.0 + grid * (distance + 0.005), rng.uniform(-np.pi, np.pi, (6, 1))], axis=1)[None]
    driver = make_driver(kind, SHEET, FREE, CELL, PERIOD, 3 * PERIOD, keep_distance=distance)
    driver.reset(pose)
    for _ in range(8):
        pose = drive(driver, pose, rng.integers(0, len(ACTION_NAMES[kind]), 6).tolist())
        assert apart(pose) >= distance - 1e-9


def test_two_head_on_halt_at_their_distance_and_are_held_back_until_they_back_off() -> None:
    pose = np.array([[[1.0, 1.0, 0.0], [1.5, 1.0, math.pi]]])
    driver = make_driver("wheels", SHEET, FREE, CELL, PERIOD, 3 * PERIOD, keep_distance=0.2)
    driver.reset(pose)
    first = drive(driver, pose, [Wheels.FORWARD, Wheels.FORWARD])
    assert first[0, 0, 0] == pytest.approx(1.06), "far from each other they go at top speed"
    assert not driver.held_back.any()
    met = drive(driver, pose, [Wheels.FORWARD, Wheels.FORWARD], decisions=30)
    assert apart(met) == pytest.approx(0.2, abs=1e-3)
    assert driver.held_back.all()
    turned = drive(driver, met, [Wheels.SPIN_LEFT, Wheels.FORWARD])
    assert turned[0, 0, 2] == pytest.approx(0.3 * SHEET.top_turn_rate), "turning is free"
    assert driver.held_back.tolist() == [[False, True]]
    back = drive(driver, met, [Wheels.BACK, Wheels.STOP])
    assert met[0, 0, 0] - back[0, 0, 0] == pytest.approx(0.06), "so is backing off"


def test_who_passes_beside_another_is_not_slowed_down() -> None:
    pose = np.array([[[1.0, 1.0, 0.0], [1.3, 1.2, math.pi]]])
    driver = make_driver("wheels", SHEET, FREE, CELL, PERIOD, 3 * PERIOD, keep_distance=0.15)
    driver.reset(pose)
    passed = drive(driver, pose, [Wheels.FORWARD, Wheels.FORWARD], decisions=5)
    assert passed[0, :, 0].tolist() == pytest.approx([1.3, 1.0])


@pytest.mark.parametrize("action", list(Cardinal))
@pytest.mark.parametrize(("column", "row"), [(0, 0), (0, 2), (3, 2), (3, 0)])
def test_whoever_stands_in_a_corner_of_the_map_is_not_driven_off_it(column, row, action):
    """No simulated robot comes there; real ones do, where walls are only drawn."""
    free = np.zeros((3, 4), np.bool_)
    free[1, 1:3] = True
    driver = make_driver("cardinal", RobotSheet(), free, 0.2, 0.1, 0.3)
    pose = np.array([[[0.2 * (column + 0.5), 0.2 * (row + 0.5), 0.0]]])
    driver.reset(pose)
    driver.begin(pose, np.array([[int(action)]]))
    assert (driver.wheel_speeds(pose) == 0.0).all()
