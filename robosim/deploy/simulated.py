"""Stand-ins for reality: a team in a physical world that obeys wheel speeds, to try a controller on.

There are two physics: pymunk, in which teams learn, and MuJoCo, which shares none of its code with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from robosim.arena import Arena
from robosim.deploy.controller import Command, Controller
from robosim.deploy.readings import Readings
from robosim.discretise.cells import Grid
from robosim.discretise.noise import make_sensor
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.profile import ProfileConfig
from robosim.envs.vector import SENSING
from robosim.episodes.frame import Frame
from robosim.errors import refused
from robosim.robot.drivers import STOP
from robosim.world.contacts import no_contacts
from robosim.world.physics import PhysicsWorld
from robosim.world.state import LOOSE

EngineKind = Literal["pymunk", "mujoco"]
"""`pymunk`: the physics that teams learn in; `mujoco`: the second one, three-dimensional."""
ENGINES: tuple[EngineKind, ...] = get_args(EngineKind)


class SimulatedRobots:
    """A team in a physical world: it is read as real robots are, and moves as a controller commands.

    A profile of the configuration makes robots unlike their data sheet and their poses noisy, late or lost,
    as in training; pheromones are read by the controller, so what a profile says of them does not count here.
    """

    def __init__(self, config: EnvConfig, seed: int, episode: int = 0, engine: EngineKind = "pymunk") -> None:
        """Begin the episode that a `VectorEnv` of one environment with this seed begins.

        InputError for more robots than the arena has room for, and for what the engine does not know.
        """
        self.config, self.arena = env_config(config)
        profile = self.config.profile or ProfileConfig()
        self.world = _world_of(engine)(
            self.arena,
            config.robots,
            1,
            config.actions,
            config.pellet_gradient,
            profile.motion,
            self.config.keep_distance,
        )
        """The world inside, for measurements and pictures: `state` and `contacts` of the last decision."""
        self.world.reset([np.random.SeedSequence(seed, spawn_key=(episode,))])
        self._sensor = make_sensor(profile.sensing, self.world)
        self._sensor.reset([np.random.SeedSequence(seed, spawn_key=(episode, SENSING))])
        self._periods = 0
        self._look()

    @property
    def now(self) -> float:
        """Simulated time, s."""
        return self._periods * self.arena.timing.control_period

    def readings(self) -> Readings:
        """Return what the robots' sensors say.

        A pose is that of the last fix, plus the robot's own motion since the decision began, and its time is
        the moment it stands for: behind `now` where a fix is late or lost.
        """
        state, timing = self.world.state, self.arena.timing
        begins = self._periods % timing.control_steps == 0
        pellet = np.full((self.world.robots, 2), np.nan)
        if state.pellets.size:
            nearest = state.nearest[0]
            loose = state.pellet_status[0, nearest] == LOOSE
            pellet[loose] = state.pellets[0, nearest[loose]]
        return Readings(
            time=self.now - self._age,
            pose=self._fix.copy() if begins else state.pose[0] + self._astray,
            laden=state.held[0] >= 0,
            at_pellet=state.touching[0] >= 0,
            touched=state.touched[:, 0].copy(),
            pellet=pellet,
        )

    def obey(self, command: Command) -> None:
        """Hold the command's wheel speeds for a control period; grippers move at the end of a decision."""
        steps = self.arena.timing.control_steps
        if self._periods % steps == 0:
            self.world.begin_decision()
        self._periods += 1
        if self._periods % steps == 0:
            self.world.end_decision(command.wheel_speeds[None], command.gripper[None])
            self._look()
        else:
            self.world.drive(command.wheel_speeds[None])

    def _look(self) -> None:
        """Measure poses, once in a decision."""
        state = self.world.state
        self._fix = self._sensor.sense(state).pose[0].copy()
        self._astray = self._fix - state.pose[0]
        age = self._sensor.age * self.arena.timing.decision_period
        self._age = np.broadcast_to(age, state.held.shape)[0]


def driven(controller: Controller, robots: SimulatedRobots, decisions: int) -> Iterator[Frame]:
    """Let a fresh controller drive a team for so many decisions; yield the start, and what each led to.

    Bodies, pellets and contacts are those of the world, modes and pheromones those of the controller; nobody
    works out rewards. A frame's arrays are valid until the next one.
    """
    world, timing = robots.world, robots.arena.timing
    count = world.robots
    grid = Grid(robots.arena, margin=1)
    action, delivered = np.full(count, STOP), np.zeros(count, np.int64)
    for step in range(decisions + 1):
        # Decides, and so knows of the moment that the frame shows.
        command = controller.step(robots.readings(), robots.now)
        state = world.state
        if step:
            delivered = delivered + state.deliveries[0]
        cells = grid.flat_index(grid.cell_coordinates(state.pose[..., :2]))
        yield Frame(
            step=step,
            time=step * timing.decision_period,
            pose=state.pose[0],
            mode=controller.mode,
            laden=state.held[0] >= 0,
            action=action,
            reward=np.full(count, np.nan, np.float32),
            pellets=state.pellets[0],
            pellet_status=state.pellet_status[0],
            delivered=delivered,
            energy=np.zeros(count),
            closest=np.full(count, np.inf),
            density=float(grid.tunnel_density(cells)[0]),
            pheromone=controller.occupancy,
            contacts=world.contacts if step else no_contacts(),
        )
        assert command.actions is not None  # noqa: S101  a decision begins, which mypy cannot know
        action = command.actions
        robots.obey(command)
        for _ in range(timing.control_steps - 1):
            robots.obey(controller.step(robots.readings(), robots.now))


def make_stand_in(
    engine: EngineKind,
    base: EnvConfig | Arena | str | Path,
    robots: int | None = None,
    seed: int = 0,
    profile: ProfileConfig | str | Path | None = None,
    episode: int = 0,
) -> SimulatedRobots:
    """Return a team in one of the engines, on an arena or in whatever environment `base` is.

    `robots` and `profile` take the place of what `base` says. InputError for values out of range, and
    ModuleNotFoundError where the engine is not installed.
    """
    if engine not in ENGINES:
        raise refused("engine", engine, " or ".join(ENGINES))
    config, _ = env_config(base, robots=robots, profile=profile)
    return SimulatedRobots(config, seed, episode, engine)


def _world_of(engine: EngineKind) -> type[PhysicsWorld]:
    if engine == "pymunk":
        return PhysicsWorld
    from robosim.deploy.mujoco import MujocoWorld

    return MujocoWorld
