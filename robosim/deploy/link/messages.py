"""The messages between robots, the pheromone service and the world: fixed layouts, a few bytes each.

Every message begins with the same header, and all numbers are little-endian. What arrives is checked before
anything else looks at it: its length, its kind, and the range of each number. Nothing in a message is code,
the name of a file, or a size that memory would be reserved for.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.modes import Mode
from robosim.discretise.pheromone import CHANNELS, QUARTERS

VERSION = 2
"""Of all layouts below; a process takes no other."""
MOST_BYTES = 262_144
"""Of a message; what is longer is not even looked at."""
NOBODY = 0
"""In place of an instance: no process."""
NO_POSE = -1.0
"""In place of a time."""
NORTH_UP = 255
"""In place of a quarter turn: the patch is read as on the map."""

MOST_ROBOTS = 1000
MOST_REASON = 100
"""Bytes of a reason in words."""

_MAGIC = b"RS"
_HEADER = struct.Struct("<2sBBHQId")
_FASTEST_WHEEL = 1e4
"""rad/s; faster than any wheel, so a sign of garbage."""
LONGEST_TIME = 1e7
"""s, some four months: so the number of a decision fits its four bytes in every arena."""
_PATCH = np.dtype("<f4")


class Kind(IntEnum):
    """What a message is."""

    CLOCK = 1
    POSE = 2
    BODY = 3
    COMMAND = 4
    DEPOSIT = 5
    READING = 6
    FIELD = 7
    ORDER = 8


class Stage(IntEnum):
    """Where a run is."""

    WAITING = 0
    """Not everybody has come; robots stand."""
    RUNNING = 1
    OVER = 2


_STAGES = frozenset(Stage)


class Rest(IntEnum):
    """What is known of a robot that an emergency stop holds."""

    UNKNOWN = 0
    """It has not said that it holds."""
    HOLDS = 1
    """It has stopped its wheels, and has had no time yet to be seen at rest."""
    STANDS = 2
    """It has been seen at rest."""
    MOVES = 3
    """It could not stop: it still moves, or is not seen."""


_RESTS = frozenset(Rest)


class MessageError(ValueError):
    """A message that is not what it should be, and why, in a few words."""


@dataclass(frozen=True, slots=True)
class Header:
    """What every message begins with."""

    kind: Kind
    robot: int
    """Whom the message is from or for; 0 where it concerns nobody in particular."""
    instance: int
    """Of the process that sent it: a number drawn when the process began, never `NOBODY`."""
    sequence: int
    """Counts the messages of one instance on one key, from 1."""
    sent: float
    """On the sender's monotonic clock, s: differences alone mean something."""


class Message(Protocol):
    """A message behind its header."""

    kind: ClassVar[Kind]

    def body(self) -> bytes: ...

    @classmethod
    def from_body(cls, data: bytes) -> Self: ...


@dataclass(frozen=True, slots=True)
class Clock:
    """World to all, in every control period and at least ten times a second: the heartbeat of a run."""

    kind: ClassVar[Kind] = Kind.CLOCK
    _layout: ClassVar[struct.Struct] = struct.Struct("<QddBQH")
    _held: ClassVar[struct.Struct] = struct.Struct("<2Q")

    setup: int
    """Of arena, team and pheromones (`robosim.deploy.link.setup`): all processes must have the same."""
    time: float
    """Of the world, s since the run began."""
    speed: float
    """World seconds in a second; 0 for as fast as all answer."""
    stage: Stage
    service: int
    """Instance of the pheromone service, or `NOBODY`."""
    drivers: tuple[int, ...]
    """[robots] instance whose commands the world obeys for each robot, or `NOBODY`."""
    hold: int = NOBODY
    """The emergency stop that holds the team: the instance of whoever ordered it, or `NOBODY`."""
    released: int = NOBODY
    """The emergency stop that was released last, or `NOBODY`."""
    rest: tuple[Rest, ...] = ()
    """[robots] what is known of each while all are held; empty for `UNKNOWN` of all."""
    reason: str = ""
    """Why all are held."""

    def body(self) -> bytes:
        count = len(self.drivers)
        head = self._layout.pack(self.setup, self.time, self.speed, self.stage, self.service, count)
        rest = bytes(self.rest or count)
        held = self._held.pack(self.hold, self.released)
        return head + struct.pack(f"<{count}Q", *self.drivers) + held + rest + _packed(self.reason)

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        if len(data) < cls._layout.size:
            raise MessageError("too short")
        setup, time, speed, stage, service, count = cls._layout.unpack_from(data)
        _require(1 <= count <= MOST_ROBOTS, "number of robots out of range")
        end = cls._layout.size + 8 * count
        words = end + cls._held.size + count
        _require(len(data) > words, "too short")
        _require_time(time)
        _require(0.0 <= speed <= 1000.0, "speed out of range")
        _require(stage in _STAGES, "unknown stage")
        drivers = struct.unpack_from(f"<{count}Q", data, cls._layout.size)
        hold, released = cls._held.unpack_from(data, end)
        rest = data[end + cls._held.size : words]
        _require(_RESTS.issuperset(rest), "unknown state of rest")
        reason = _unpacked(data[words:])
        return cls(
            *(setup, time, speed, Stage(stage), service, drivers),
            *(hold, released, tuple(map(Rest, rest)), reason),
        )


@dataclass(frozen=True, slots=True)
class Pose:
    """Tracker to all: where a robot was seen."""

    kind: ClassVar[Kind] = Kind.POSE
    _layout: ClassVar[struct.Struct] = struct.Struct("<5d")

    time: float
    """Of the tracker's frame, of the world, s: later frames have later times, also where a robot is lost."""
    x: float
    """m, on the arena's map; NaN, as y and heading, where the robot was not seen."""
    y: float
    heading: float
    """rad."""
    age: float = 0.0
    """How long before `time` the robot was there, s: more than 0 where a fix comes late or is an old one."""

    def body(self) -> bytes:
        return self._layout.pack(self.time, self.x, self.y, self.heading, self.age)

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        _require_length(data, cls._layout.size)
        time, x, y, heading, age = cls._layout.unpack(data)
        pose = (x, y, heading)
        _require_time(time)
        _require(0.0 <= age <= LONGEST_TIME, "age out of range")
        lost = [math.isnan(number) for number in pose]
        _require(all(lost) or not any(lost), "half a pose")
        _require(all(lost) or all(abs(number) <= 1e6 for number in pose), "pose out of range")
        return cls(time, x, y, heading, age)


@dataclass(frozen=True, slots=True)
class Body:
    """A robot's own sensors to its process; on a real robot they are wired to it."""

    kind: ClassVar[Kind] = Kind.BODY
    _layout: ClassVar[struct.Struct] = struct.Struct("<d5B2d")

    time: float
    laden: bool
    """The gripper holds a pellet."""
    at_pellet: bool
    """The gripper touches a loose pellet."""
    touched: tuple[bool, bool, bool]
    """Another robot or its pellet, a wall, a loose pellet, since the last decision."""
    pellet: tuple[float, float] | None
    """m, on the map: the loose pellet nearest to the gripper, if one is known."""

    def body(self) -> bytes:
        place = (math.nan, math.nan) if self.pellet is None else self.pellet
        return self._layout.pack(self.time, self.laden, self.at_pellet, *self.touched, *place)

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        _require_length(data, cls._layout.size)
        time, *flags, x, y = cls._layout.unpack(data)
        _require_time(time)
        _require(max(flags) <= 1, "flag out of range")
        laden, at_pellet, robot, wall, pellet = (bool(flag) for flag in flags)
        _require(math.isnan(x) == math.isnan(y), "half a place")
        known = not math.isnan(x)
        _require(not known or max(abs(x), abs(y)) <= 1e6, "place out of range")
        return cls(time, laden, at_pellet, (robot, wall, pellet), (x, y) if known else None)


@dataclass(frozen=True, slots=True)
class WheelCommand:
    """A robot's process to its wheels and gripper."""

    kind: ClassVar[Kind] = Kind.COMMAND
    _layout: ClassVar[struct.Struct] = struct.Struct("<3dbQB")

    time: float
    """Of the pose that it answers, s; `NO_POSE` as long as the run has not begun."""
    left: float
    """rad/s."""
    right: float
    gripper: int
    """`Gripper`, to be done at the end of the decision."""
    hold: int = NOBODY
    """The emergency stop that holds this robot, or `NOBODY`."""
    rest: Rest = Rest.UNKNOWN
    """While it is held: whether it has come to rest."""

    def body(self) -> bytes:
        return self._layout.pack(self.time, self.left, self.right, self.gripper, self.hold, self.rest)

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        _require_length(data, cls._layout.size)
        time, left, right, gripper, hold, rest = cls._layout.unpack(data)
        _require_time(time if time != NO_POSE else 0.0)
        _require(abs(left) <= _FASTEST_WHEEL and abs(right) <= _FASTEST_WHEEL, "wheel speed out of range")
        _require(-1 <= gripper <= 1, "gripper out of range")
        _require(rest in _RESTS, "unknown state of rest")
        return cls(time, left, right, gripper, hold, Rest(rest))


@dataclass(frozen=True, slots=True)
class Deposit:
    """Robot to pheromone service, once in a decision: where it is, and the marks that it leaves."""

    kind: ClassVar[Kind] = Kind.DEPOSIT
    _layout: ClassVar[struct.Struct] = struct.Struct("<I2H5B")

    decision: int
    """Counts decisions of the world's clock from 0."""
    column: int
    row: int
    facing: int
    """The patch is read from ahead to behind, to this many quarters of a turn; `NORTH_UP` for the map's."""
    marks: bool
    """Whether it leaves marks; not in its first decision, before which it has done nothing."""
    mode: int
    """`Mode`."""
    laden: bool
    action: int

    def body(self) -> bytes:
        return self._layout.pack(
            self.decision, self.column, self.row, self.facing, self.marks, self.mode, self.laden, self.action
        )

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        _require_length(data, cls._layout.size)
        decision, column, row, facing, marks, mode, laden, action = cls._layout.unpack(data)
        _require(facing < QUARTERS or facing == NORTH_UP, "direction out of range")
        _require(marks <= 1 and laden <= 1, "flag out of range")
        _require(mode < len(Mode), "unknown mode")
        return cls(decision, column, row, facing, bool(marks), mode, bool(laden), action)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Pheromone service to a robot, answering its deposit: what is on the map around it."""

    kind: ClassVar[Kind] = Kind.READING
    _layout: ClassVar[struct.Struct] = struct.Struct("<IHd")

    decision: int
    """Of the map that was read."""
    radius: int
    """Cells up to this many rows and columns away."""
    density: float
    """Robots in the tunnel per cell of its length."""
    patch: NDArray[np.float32]
    """[channels * cells], 0 to 1, as `PheromoneMap.read` writes it."""

    def body(self) -> bytes:
        head = self._layout.pack(self.decision, self.radius, self.density)
        return head + self.patch.astype(_PATCH).tobytes()

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        if len(data) < cls._layout.size:
            raise MessageError("too short")
        decision, radius, density = cls._layout.unpack_from(data)
        _require_length(data, cls._layout.size + 4 * patch_numbers(radius))
        _require(0.0 <= density <= MOST_ROBOTS, "density out of range")
        patch = np.frombuffer(data, _PATCH, offset=cls._layout.size).astype(np.float32)
        _require(bool(((patch >= 0.0) & (patch <= 1.0)).all()), "pheromone out of range")
        return cls(decision, radius, density, patch)


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Pheromone service to whoever draws it: the occupancy of all cells."""

    kind: ClassVar[Kind] = Kind.FIELD
    _layout: ClassVar[struct.Struct] = struct.Struct("<I2H")

    decision: int
    occupancy: NDArray[np.float32]
    """[rows, columns], row 0 at the bottom."""

    def body(self) -> bytes:
        head = self._layout.pack(self.decision, *self.occupancy.shape)
        return head + self.occupancy.astype(_PATCH).tobytes()

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        if len(data) < cls._layout.size:
            raise MessageError("too short")
        decision, rows, columns = cls._layout.unpack_from(data)
        _require_length(data, cls._layout.size + 4 * rows * columns)
        field = np.frombuffer(data, _PATCH, offset=cls._layout.size).astype(np.float32)
        _require(bool((np.isfinite(field) & (field >= 0.0)).all()), "pheromone out of range")
        return cls(decision, field.reshape(rows, columns))


@dataclass(frozen=True, slots=True)
class Order:
    """Operator to world, until the clock shows that it was heard: hold all robots, or release them."""

    kind: ClassVar[Kind] = Kind.ORDER
    _layout: ClassVar[struct.Struct] = struct.Struct("<Q")

    release: int = NOBODY
    """The emergency stop that is to end, so that none is ended that the sender has not seen; `NOBODY` for a
    new one, which goes by the sender's instance."""
    reason: str = ""
    """Why."""

    def body(self) -> bytes:
        return self._layout.pack(self.release) + _packed(self.reason)

    @classmethod
    def from_body(cls, data: bytes) -> Self:
        _require(len(data) > cls._layout.size, "too short")
        (release,) = cls._layout.unpack_from(data)
        return cls(release, _unpacked(data[cls._layout.size :]))


AnyMessage = Clock | Pose | Body | WheelCommand | Deposit | Reading | Field | Order
_KINDS: dict[int, type[AnyMessage]] = {
    kind.kind: kind for kind in (Clock, Pose, Body, WheelCommand, Deposit, Reading, Field, Order)
}


def patch_numbers(radius: int) -> int:
    """Return how many numbers a patch of that radius holds, all channels."""
    return len(CHANNELS) * (2 * radius + 1) ** 2


def pack(message: Message, robot: int, instance: int, sequence: int, sent: float) -> bytes:
    """Return a message with its header, as it is sent."""
    return _HEADER.pack(_MAGIC, VERSION, message.kind, robot, instance, sequence, sent) + message.body()


def unpack(data: bytes) -> tuple[Header, AnyMessage]:
    """Return what a message says; MessageError for anything that is not one of ours, whole and in range."""
    if len(data) > MOST_BYTES:
        raise MessageError("too long")
    if len(data) < _HEADER.size:
        raise MessageError("too short")
    magic, version, kind, robot, instance, sequence, sent = _HEADER.unpack_from(data)
    _require(magic == _MAGIC, "not a message of robosim")
    _require(version == VERSION, f"of version {version}, not {VERSION}")
    _require(kind in _KINDS, "of an unknown kind")
    _require(robot < MOST_ROBOTS, "robot out of range")
    _require(instance != NOBODY, "from no process")
    _require(abs(sent) <= 1e12, "sent at no time")
    header = Header(Kind(kind), robot, instance, sequence, sent)
    return header, _KINDS[header.kind].from_body(data[_HEADER.size :])


def _packed(reason: str) -> bytes:
    """Return a reason behind its length, cut where it is too long."""
    text = reason.encode()[:MOST_REASON].decode(errors="ignore").encode()
    return bytes([len(text)]) + text


def _unpacked(data: bytes) -> str:
    """Return the reason that ends a message."""
    _require_length(data, 1 + data[0])
    _require(data[0] <= MOST_REASON, "reason too long")
    try:
        reason = data[1:].decode()
    except UnicodeDecodeError:
        raise MessageError("reason is no text") from None
    # It is written to logs, which are read in terminals.
    _require(reason.isprintable(), "reason does not print")
    return reason


def _require(holds: bool, otherwise: str) -> None:
    # Comparisons with NaN do not hold, so what must not be NaN is refused by its range.
    if not holds:
        raise MessageError(otherwise)


def _require_length(data: bytes, length: int) -> None:
    if len(data) != length:
        raise MessageError("too short" if len(data) < length else "too long")


def _require_time(time: float) -> None:
    _require(0.0 <= time <= LONGEST_TIME, "time out of range")
