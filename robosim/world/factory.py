"""Which world an environment runs in."""

from __future__ import annotations

from typing import Literal, get_args

from robosim.arena.model import Arena
from robosim.errors import refused
from robosim.robot.drivers import ActionKind
from robosim.world.draws import room_apart
from robosim.world.motion import EXACT, MotionConfig
from robosim.world.state import World

WorldKind = Literal["physics", "grid"]
"""`physics`: rigid bodies; `grid`: the paper's abstraction, one robot a cell."""
WORLD_KINDS: tuple[WorldKind, ...] = get_args(WorldKind)


def room_in(kind: WorldKind, arena: Arena, keep_distance: float | None = None) -> int:
    """Return how many robots fit an arena in a world of that kind, at a distance (m) from each other if any.

    InputError for an arena that has no meaning there.
    """
    if kind == "grid":
        from robosim.world.grid.layout import grid_arena

        return grid_arena(arena).capacity
    return arena.capacity if keep_distance is None else room_apart(arena, keep_distance)


def make_world(
    kind: WorldKind,
    arena: Arena,
    robots: int,
    num_envs: int,
    actions: ActionKind = "cardinal",
    pellet_gradient: float = 0.0,
    motion: MotionConfig = EXACT,
    keep_distance: float | None = None,
) -> World:
    """Return a batch of worlds of that kind; nothing else names one.

    `pellet_gradient` says how unevenly pellets may lie as an episode begins, `motion` how robots differ from
    their data sheet, `keep_distance` (m) how far apart robots keep their centres. Raises InputError when the
    robots do not fit the arena, and for what this world does not know. Loads the world's own libraries late.
    """
    if kind == "grid":
        from robosim.world.grid import GridWorld

        # Up to a cell's length it is kept by the rules.
        if keep_distance is not None and keep_distance > arena.cell_size:
            room = f"at most {arena.cell_size:g} in the grid world, where robots stand in neighbouring cells"
            raise refused("keep_distance", keep_distance, room)
        return GridWorld(arena, robots, num_envs, actions, pellet_gradient, motion)
    from robosim.world.physics import PhysicsWorld

    return PhysicsWorld(arena, robots, num_envs, actions, pellet_gradient, motion, keep_distance)
