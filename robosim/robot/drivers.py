"""Drivers: what a robot's own controller makes of a policy's action, as wheel speeds.

A policy decides once in a decision period; the driver runs in every control period between.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.robot.kinematics import body_twist, wheel_speeds_for
from robosim.robot.team import TeamSheet, per_wheel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
JAMMED_TURN = 0.3
"""A turn on the spot that makes less than this share of its commanded angle is jammed."""
MIDDLE_SHARE = 2.0 / 3.0
"""Before a wall, a robot this near to the middle of its cell halts, as a share of the distance that top
speed drives in a decision: so it ends no further beyond the middle than the rest of that distance."""
WIGGLE_SPEEDS = np.array([0.0, -0.5, 0.5, -0.5, 0.5, -0.5])
"""Speeds in the decisions that a jam lasts, in top speeds: back out of it, then forward, and so on."""
HELD_BACK = 0.1
"""A robot that may drive at less than this share of its commanded speed is held back."""
ActionKind = Literal["cardinal", "wheels", "wheels-9"]
ACTION_KINDS: tuple[ActionKind, ...] = ("cardinal", "wheels", "wheels-9")
STOP = 4
"""Stop has the same number in every kind."""

TURN_FIRST_ABOVE = np.array(np.radians(40.0))
"""Heading error above which the cardinal driver turns on the spot before it drives, rad."""
STEERING_GAIN = 4.0
"""Turning rate per heading error while driving, 1/s; gentle, so that steering costs little speed."""


class Cardinal(IntEnum):
    """Actions of kind `cardinal`: toward the neighbouring cell."""

    NORTH = 0
    SOUTH = 1
    WEST = 2
    EAST = 3
    STOP = 4


class Wheels(IntEnum):
    """Actions of kinds `wheels`, the first five, and `wheels-9`: wheel speeds held for the whole decision."""

    FORWARD = 0
    BACK = 1
    SPIN_LEFT = 2
    SPIN_RIGHT = 3
    STOP = 4
    BEAR_LEFT = 5
    BEAR_RIGHT = 6
    BACK_LEFT = 7
    BACK_RIGHT = 8


WHEEL_SPEEDS = np.array(
    [[1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [0.0, 0.0],
     [0.5, 1.0], [1.0, 0.5], [-0.5, -1.0], [-1.0, -0.5]]
)  # fmt: skip
"""[9, 2] speeds of the left and the right wheel of `Wheels`, as shares of the top wheel speed."""


CARDINAL_STEPS = np.array([[0, 1], [0, -1], [-1, 0], [1, 0], [0, 0]], dtype=np.int64)
"""[5, 2] steps (columns, rows) of the cardinal actions; rows grow northward."""

TWO_PI = np.array(2.0 * np.pi)
PER_TWO_PI = np.array(1.0 / TWO_PI)

ACTION_NAMES: dict[str, tuple[str, ...]] = {
    "cardinal": ("north", "south", "west", "east", "stop"),
    "wheels": ("forward", "back", "spin left", "spin right", "stop"),
    "wheels-9": (
        "forward", "back", "spin left", "spin right", "stop",
        "bear left", "bear right", "back left", "back right",
    ),
}  # fmt: skip
FEWEST_ACTIONS = min(map(len, ACTION_NAMES.values()))
"""Of any kind."""


class Driver(Protocol):
    """Turns the actions of one decision into wheel speeds, one control period at a time."""

    held_back: NDArray[np.bool_]
    """[envs, robots] kept from driving on, in the last control period, by its distance to another robot."""

    def reset(self, pose: Floats) -> None:
        """Forget what was: new episodes begin, at `pose` [envs, robots, 3]."""
        ...

    def begin(self, pose: Floats, actions: Integers) -> None:
        """Take the decision's actions [envs, robots] at the poses [envs, robots, 3]."""
        ...

    def wheel_speeds(self, pose: Floats) -> Floats:
        """Return wheel speeds [envs, robots, 2] in rad/s for the next control period."""
        ...


class CardinalDriver:
    """Turns toward the centre of the neighbouring cell and drives there, stopping for walls but for nobody.

    The target is fixed when the decision begins, so a robot that follows one direction is drawn to
    the middle of its row or column of cells. A robot whose turn is jammed, its pellet or its tail
    against a wall, backs and advances in turn until it is free.
    """

    def __init__(
        self,
        sheet: TeamSheet,
        free: NDArray[np.bool_],
        cell_size: float,
        control_period: float,
        decision_period: float,
    ) -> None:
        """Take the free cells [rows, columns] of the map, the size of a cell (m) and the periods (s)."""
        self._sheet = sheet
        self._free = free.ravel()
        self._columns = free.shape[1]
        self._cell = cell_size
        self._period = control_period
        self._close_enough = MIDDLE_SHARE * sheet.top_speed * decision_period / cell_size
        # Arrays of one number: numpy takes them much faster than Python's, and this runs most often of all.
        self._half_base = np.array(0.5 * sheet.wheel_base)
        self._top_speed = np.array(sheet.top_speed)
        self._top_turn_rate = np.array(sheet.top_turn_rate)
        self._gains = np.array([STEERING_GAIN, 1.0 / control_period])
        self.held_back = np.zeros(0, dtype=np.bool_)
        self._target: Floats = np.empty(0)
        self._go = np.empty(0)
        self._jam = np.zeros(0, dtype=np.int64)
        self._wiggle = np.zeros(0)
        self._heading = np.zeros(0)
        self._turn = np.zeros(0)
        self._turning = np.zeros(0)
        self._sense = np.zeros(0)
        self._error = np.zeros(0)

    def reset(self, pose: Floats) -> None:
        self.held_back = np.zeros(pose.shape[:2], dtype=np.bool_)
        self._jam = np.zeros(pose.shape[:2], dtype=np.int64)
        self._heading = pose[..., 2].copy()
        self._turn = np.zeros(pose.shape[:2])
        self._turning = np.zeros(pose.shape[:2])
        self._error = np.zeros(pose.shape[:2])

    def begin(self, pose: Floats, actions: Integers) -> None:
        coordinates = pose[..., :2] * (1.0 / self._cell)
        cells = coordinates.astype(np.int64)
        steps = CARDINAL_STEPS.take(actions, axis=0)
        target = cells + steps
        # Nobody drives into a wall: with one ahead, a robot closes up to the middle of its cell and halts.
        # Whoever stands on the map's border, as a real robot may, has a wall ahead beyond it, too.
        clear = self._free.take(target[..., 1] * self._columns + target[..., 0], mode="clip")
        to_middle = (cells + 0.5 - coordinates) * steps
        far = to_middle[..., 0] + to_middle[..., 1] >= self._close_enough
        self._go = ((actions != STOP) & (clear | far)).astype(np.float64)
        self._target = (target + np.float64(0.5)) * self._cell
        # A turn on the spot over the last decision that got nowhere; a passage of the heading from
        # pi to -pi looks like a turn, and only puts the finding off.
        turned = np.abs(pose[..., 2] - self._heading)
        self._jam += turned < (JAMMED_TURN * self._period) * self._turn
        self._jam *= self._turn > 0.0
        # A turn once begun keeps its sense of rotation, even for the larger angle, unless the new direction
        # lies within a right angle: a policy that changes its mind in every decision still gets round.
        self._sense = np.copysign(0.25 * (self._turning > 0.0), self._error)
        self._wiggle = WIGGLE_SPEEDS.take(self._jam, mode="wrap") * self._sheet.top_speed
        self._heading = pose[..., 2].copy()
        self._turn.fill(0.0)

    def wheel_speeds(self, pose: Floats) -> Floats:
        sheet = self._sheet
        ahead = self._target - pose[..., :2]
        error = np.arctan2(ahead[..., 1], ahead[..., 0])
        error -= pose[..., 2]
        turns = error * PER_TWO_PI
        turns -= self._sense
        np.rint(turns, out=turns)
        turns *= TWO_PI
        error -= turns
        error *= self._go
        size = np.abs(error)
        on_the_spot = size > TURN_FIRST_ABOVE
        size *= self._gains.take(on_the_spot)
        rate = np.minimum(size, self._top_turn_rate, out=size)
        # What turning leaves of the wheels' speed goes into driving, once the robot faces the cell.
        speed = self._top_speed - self._half_base * rate
        np.copyto(speed, self._wiggle, where=on_the_spot)
        speed *= self._go
        self._turning = rate * on_the_spot
        self._turn += self._turning
        self._error = error
        return wheel_speeds_for(sheet, speed, np.copysign(rate, error))


class WheelsDriver:
    """Holds the wheel speeds of the action for the whole decision."""

    def __init__(self, sheet: TeamSheet) -> None:
        self._top = per_wheel(sheet.max_wheel_speed)
        self._speeds = np.empty(0)
        self.held_back = np.zeros(0, dtype=np.bool_)

    def reset(self, pose: Floats) -> None:
        self.held_back = np.zeros(pose.shape[:2], dtype=np.bool_)

    def begin(self, pose: Floats, actions: Integers) -> None:
        self._speeds = WHEEL_SPEEDS.take(actions, axis=0) * self._top

    def wheel_speeds(self, pose: Floats) -> Floats:
        return self._speeds


class DistanceKeeper:
    """Slows robots down before their centres come nearer to each other than a distance.

    A control barrier function, as the Robotarium protects its robots by (Wang 2017), each robot for itself:
    of the gap that is left, it may use up half within the control period, and must be able to brake in the
    rest of its half. Turning on the spot and backing off are always free. Between robots that know their
    poses and obey at once, the distance holds whatever is commanded. Rigid bodies take a moment to obey, so
    theirs may be some millimetres less.
    """

    def __init__(self, driver: Driver, sheet: TeamSheet, distance: float, control_period: float) -> None:
        """Take whose commands are limited, and the least distance between centres (m)."""
        self._driver = driver
        self._sheet = sheet
        self._limit = per_wheel(sheet.max_wheel_speed)
        self._distance = distance
        self._half_period = 0.5 * control_period
        self._acceleration = np.asarray(sheet.top_acceleration)[..., None]
        self._gain = self._acceleration * control_period
        self.held_back = np.zeros(0, dtype=np.bool_)

    def reset(self, pose: Floats) -> None:
        self._driver.reset(pose)
        self.held_back = np.zeros(pose.shape[:2], dtype=np.bool_)

    def begin(self, pose: Floats, actions: Integers) -> None:
        self._driver.begin(pose, actions)

    def wheel_speeds(self, pose: Floats) -> Floats:
        sheet, limit = self._sheet, self._limit
        speed, rate = body_twist(sheet, np.clip(self._driver.wheel_speeds(pose), -limit, limit))
        # Along the chord of the arc that the robot describes until the next command.
        course = pose[..., 2] + rate * self._half_period
        to_others = pose[:, None, :, :2] - pose[:, :, None, :2]
        distance = np.hypot(to_others[..., 0], to_others[..., 1])
        toward = to_others[..., 0] * np.cos(course)[..., None] + to_others[..., 1] * np.sin(course)[..., None]
        toward /= np.where(distance > 0.0, distance, 1.0)
        share = np.maximum(0.5 * (distance - self._distance), 0.0)
        # v T + v^2 / (2 a) <= share: what it drives in the period, and its braking distance.
        approach = np.sqrt(self._gain**2 + 2.0 * self._acceleration * share) - self._gain
        near = speed[..., None] * toward > approach
        allowed = np.divide(approach, np.abs(toward), out=np.full_like(approach, np.inf), where=near).min(
            axis=2
        )
        slowed = np.clip(speed, -allowed, allowed)
        self.held_back = np.abs(slowed) < HELD_BACK * np.abs(speed)
        return wheel_speeds_for(sheet, slowed, rate)


def make_driver(
    kind: ActionKind,
    sheet: TeamSheet,
    free: NDArray[np.bool_],
    cell_size: float,
    control_period: float,
    decision_period: float,
    keep_distance: float | None = None,
) -> Driver:
    """Return the driver for actions of `kind`; `free` [rows, columns] are the cells that are no walls.

    With `keep_distance` (m) robots keep it from each other, centre to centre.
    """
    driver: Driver = WheelsDriver(sheet)
    if kind == "cardinal":
        driver = CardinalDriver(sheet, free, cell_size, control_period, decision_period)
    return driver if keep_distance is None else DistanceKeeper(driver, sheet, keep_distance, control_period)
