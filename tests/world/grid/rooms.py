"""Small arenas for the grid, drawn as text, with robots where they are wanted."""

from __future__ import annotations

import numpy as np

from robosim.arena import Arena, parse_arena
from robosim.world.grid import GridWorld
from robosim.world.state import Gripper

NORTH, SOUTH, WEST, EAST, STOP = range(5)
FORWARD, BACK, LEFT, RIGHT = range(4)
CELL = 0.15
ROOM = """
#########
#HH.....#
#HH.....#
#.......#
#.....SS#
#.....SS#
#########
"""


def room(cells: list[tuple[int, int]], drawing: str = ROOM, heading: float = 0.0, pellets: int = 1) -> Arena:
    """Return an arena whose robots begin in `cells` (column, row), row 0 at the bottom of the drawing."""
    poses = [[(column + 0.5) * CELL, (row + 0.5) * CELL, heading] for column, row in cells]
    return parse_arena(
        f'name = "room"\ncell_size = {CELL}\nmap = """{drawing}"""\n'
        f"[pellets]\ncount = {pellets}\n[start]\nposes = {poses}\n",
        "room.toml",
    )


class Bench:
    """One world of one environment, or of several that all begin alike."""

    def __init__(self, arena: Arena, actions: str = "cardinal", envs: int = 1, seed: int = 0) -> None:
        self.world = GridWorld(arena, len(arena.start.poses), envs, actions)
        self.world.reset([np.random.SeedSequence((seed, env)) for env in range(envs)])
        self.state = self.world.state

    def decide(self, *actions: int, gripper: Gripper = Gripper.KEEP) -> list[tuple[int, int]]:
        """Take one decision, the same in every environment, and return the cells of the first one."""
        world = self.world
        shape = (world.num_envs, world.robots)
        world.step(
            np.broadcast_to(np.array(actions, dtype=np.int64), shape),
            np.full(shape, gripper, dtype=np.int8),
        )
        return self.cells()

    def cells(self) -> list[tuple[int, int]]:
        """Return (column, row) of the robots of the first environment."""
        place = self.state.pose[0, :, :2] / self.world.arena.cell_size
        return [(int(x), int(y)) for x, y in place]
