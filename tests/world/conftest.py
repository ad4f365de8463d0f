"""Worlds to do experiments in: a wide empty floor, and hands to put things where they are needed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pymunk
import pytest

from robosim.arena import Arena, parse_arena
from robosim.world.motion import EXACT, MotionConfig
from robosim.world.physics import PhysicsWorld
from robosim.world.state import Gripper

CELL = 0.2
FLOOR = "\n".join(["#" * 22, "#HH" + "." * 16 + "SS#", *["#" + "." * 20 + "#"] * 9, "#" * 22])
"""4 x 2 m inside the border; home and source in the upper corners."""


def floor_arena(
    poses: list[tuple[float, float, float]], drawing: str = FLOOR, **tables: dict[str, Any]
) -> Arena:
    """Return an arena with robots at `poses`; `tables` are those of an arena file, by their names."""
    tables.setdefault("pellets", {}).setdefault("count", 1)
    tables["start"] = {"poses": [list(map(float, pose)) for pose in poses]}
    lines = ['name = "floor"', f"cell_size = {CELL}", f'map = """\n{drawing}\n"""']
    for table, values in tables.items():
        lines += [f"[{table}]"]
        lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}"
                  for key, value in values.items()]  # fmt: skip
    return parse_arena("\n".join(lines), "floor")


class Bench:
    """One world with one environment, and direct access to its bodies."""

    def __init__(
        self,
        arena: Arena,
        actions: str = "wheels",
        motion: MotionConfig = EXACT,
        keep_distance: float | None = None,
    ) -> None:
        robots = len(arena.start.poses)
        self.arena = arena
        self.world = PhysicsWorld(arena, robots, 1, actions, motion=motion, keep_distance=keep_distance)
        self.world.reset([np.random.SeedSequence(0)])
        self._bodies = self.world._spaces[0]
        self.space: pymunk.Space = self._bodies._space

    def robot(self, index: int = 0) -> pymunk.Body:
        return self._bodies._robots[index]

    def pellet(self, index: int = 0) -> pymunk.Body:
        return self._bodies._pellets[index]

    def put_pellet(self, place: tuple[float, float], index: int = 0) -> pymunk.Body:
        """Put a loose pellet somewhere, at rest."""
        self._bodies.place(index, np.array(place))
        self.world._read_bodies()
        self.world._handle_pellets(np.zeros((1, self.world.robots), dtype=np.int8))
        return self.pellet(index)

    def drive(self, left: float, right: float, periods: int = 1) -> None:
        """Hold the same wheel speeds in all robots for some control periods."""
        for _ in range(periods):
            self.world.drive(np.broadcast_to([left, right], (1, self.world.robots, 2)).astype(float))

    def decide(self, actions: list[int], gripper: Gripper = Gripper.KEEP, times: int = 1) -> None:
        """Take decisions with the same actions and gripper commands."""
        for _ in range(times):
            self.world.step(np.array([actions]), np.full((1, self.world.robots), gripper, dtype=np.int8))

    def push(self, body: pymunk.Body, force: tuple[float, float], seconds: float) -> None:
        """Push a body at its centre with a force in N, with everything else as it was commanded."""
        substep = self.arena.timing.substep
        for _ in range(round(seconds / substep)):
            body.apply_force_at_world_point(force, body.position)
            self.space.step(substep)


@pytest.fixture(scope="session")
def bench() -> Callable[..., Bench]:
    """Build a bench: robots at `poses`, tables of the arena file by name, and the kind of actions."""

    def build(
        poses: list[tuple[float, float, float]],
        actions: str = "wheels",
        drawing: str = FLOOR,
        motion: MotionConfig = EXACT,
        keep_distance: float | None = None,
        **tables: Any,
    ) -> Bench:
        return Bench(floor_arena(poses, drawing, **tables), actions, motion, keep_distance)

    return build
