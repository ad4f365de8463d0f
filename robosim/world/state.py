"""The state of a batch of worlds, as arrays, and the protocol that every world keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.equality import EqualByValue
from robosim.robot.team import Team
from robosim.world.contacts import ContactKind, Contacts

if TYPE_CHECKING:
    from robosim.world.motion import MotionDraws

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]


class PelletStatus(IntEnum):
    """Where a pellet is."""

    LOOSE = 0
    HELD = 1
    ABSENT = 2
    """Delivered; its fresh successor waits for room in the source."""


# Arrays compare with numpy's own scalars several times faster than with members of an enumeration.
LOOSE, HELD, ABSENT = (np.uint8(status) for status in PelletStatus)


class Gripper(IntEnum):
    """The command to a robot's gripper for one decision."""

    OPEN = -1
    """Let go of what it holds."""
    KEEP = 0
    """Hold what it holds, take nothing."""
    TAKE = 1
    """Hold what it holds, or take a pellet that it touches."""


@dataclass(slots=True, eq=False)
class WorldState(EqualByValue):
    """Bodies and events of a batch of worlds; the arrays are overwritten by the next decision."""

    pose: Floats
    """[envs, robots, 3] x m, y m, heading rad in [-pi, pi)."""
    velocity: Floats
    """[envs, robots, 3] x m/s, y m/s, turning rate rad/s."""
    held: Integers
    """[envs, robots] the pellet that a robot holds, or -1."""
    nearest: Integers
    """[envs, robots] the pellet nearest to a robot's gripper; a loose one if there is any."""
    touching: Integers
    """[envs, robots] the loose pellet that a robot's gripper touches, or -1."""
    pellets: Floats
    """[envs, pellets, 2] m; an absent pellet keeps its last place."""
    pellet_status: NDArray[np.uint8]
    """[envs, pellets] `PelletStatus`."""
    touched: Bools
    """[3, envs, robots] touched, in the last decision, another robot or its pellet, a wall, a loose pellet:
    in the order of `ContactKind`."""
    picked: Integers
    """[envs, robots] the pellet taken in the last decision, or -1."""
    lost: Bools
    """[envs, robots] had its pellet torn loose in the last decision."""
    deliveries: Integers
    """[envs, robots] pellets delivered in the last decision, credited to their last holder."""
    delivered: Integers
    """[envs] pellets delivered in the episode."""
    refilled: Integers
    """[envs] fresh pellets put into the source in the episode."""
    fresh: Bools
    """[envs, pellets] put into the source anew in the last decision."""
    refused: Bools
    """[envs, robots] a move onto a cell was refused, and none has succeeded since; where bodies push, who is
    held back by the distance that it keeps."""
    odometry: Floats
    """[envs, robots, 3] x m, y m, heading rad by the turns of a robot's wheels alone, which do not know of
    slipping: of use are differences. Where nobody asked for it by `count_turns`, it stays as it is."""


def blank_state(num_envs: int, robots: int, pellets: int) -> WorldState:
    """Return a state in which nothing has happened and nobody has a place yet."""
    shape = (num_envs, robots)
    return WorldState(
        pose=np.zeros((*shape, 3)),
        velocity=np.zeros((*shape, 3)),
        held=np.full(shape, -1),
        nearest=np.zeros(shape, dtype=np.int64),
        touching=np.full(shape, -1),
        pellets=np.zeros((num_envs, pellets, 2)),
        pellet_status=np.zeros((num_envs, pellets), dtype=np.uint8),
        touched=np.zeros((len(ContactKind), *shape), dtype=np.bool_),
        picked=np.full(shape, -1),
        lost=np.zeros(shape, dtype=np.bool_),
        deliveries=np.zeros(shape, dtype=np.int64),
        delivered=np.zeros(num_envs, dtype=np.int64),
        refilled=np.zeros(num_envs, dtype=np.int64),
        fresh=np.zeros((num_envs, pellets), dtype=np.bool_),
        refused=np.zeros(shape, dtype=np.bool_),
        odometry=np.zeros((*shape, 3)),
    )


class Setting(Protocol):
    """What discretisation knows of a batch of worlds besides their state; real robots have one, too."""

    arena: Arena
    """The map, with the timing that this world keeps."""
    num_envs: int
    robots: int
    team: Team
    travel: Floats | float
    """Farthest that a robot comes in a decision, m: of all robots, or [robots]."""
    turn: Floats | float
    """Farthest that a robot turns in a decision, rad: of all robots, or [robots]."""


class World(Setting, Protocol):
    """A batch of worlds: it knows bodies, and nothing of pheromones, rewards or policies.

    This is all that discretisation, controllers, analysis and playback know of where robots are.
    """

    state: WorldState
    contacts: Contacts
    """Of the last decision."""
    on_cells: bool
    """Whether robots stand in the middle of cells, one a cell, rather than anywhere as bodies."""
    wheel_energy: Floats
    """[envs, robots] energy lost at the wheels in the episode so far, J; 0 where it is not metered, NaN in a
    world that knows no forces."""
    closest: Floats
    """[envs, robots] the least distance from a robot's centre to another's in the episode so far, m; infinite
    for one alone, and where it is not metered."""
    drawn: Sequence[MotionDraws]
    """[envs] what the episode has drawn from the ranges of its `MotionConfig`."""

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment; everything random in it comes from its one of `seeds`."""
        ...

    def step(self, actions: Integers, gripper: NDArray[np.int8], believed: Floats | None = None) -> None:
        """Advance all environments by one decision: actions and gripper are [envs, robots].

        `believed` [envs, robots, 3] is where robots take themselves to be, which they steer by; None where
        they know.
        """
        ...

    def meter(self) -> None:
        """Meter `closest` from now on, and `wheel_energy` in worlds that have wheels."""
        ...

    def count_turns(self) -> None:
        """Keep the state's `odometry` from now on."""
        ...
