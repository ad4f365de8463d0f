"""The batched environment: worlds, driver, Dec-POMDP and pheromones behind arrays [envs, robots, ...].

Every other face of the simulator is built on this one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robosim.arena import Arena
from robosim.discretise.dec_pomdp import DecPomdp
from robosim.discretise.noise import make_sensor
from robosim.discretise.pheromone import CHANNELS
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.profile import ProfileConfig
from robosim.episodes.frame import Frame
from robosim.episodes.trajectory import Trajectory
from robosim.equality import EqualByValue
from robosim.errors import InputError, refused, whole_number
from robosim.world.factory import make_world
from robosim.world.motion import MotionDraws
from robosim.world.state import World

MAX_ENVS = 4096
MAX_SEED = 2**64 - 1
MOST_NUMBERS = 250_000_000
"""In the observations of a decision, of all robots and environments together, and in pheromone maps."""
SENSING = 1
"""Key of the seeds of an episode's sensors."""


OTHER_THREAD = "another thread is stepping this environment; it must be used by one at a time."


class Transition(NamedTuple):
    """What a step of a batch of environments returns."""

    observation: NDArray[np.float32]
    """[envs, robots, size]; of the new episode where one has just ended."""
    reward: NDArray[np.float32]
    """[envs, robots]."""
    terminated: NDArray[np.bool_]
    """[envs] always False: the task has no end of its own."""
    truncated: NDArray[np.bool_]
    """[envs] the episode has reached its last decision."""
    final_observation: NDArray[np.float32]
    """[envs, robots, size] what the step itself led to; differs from `observation` after an end."""
    final_delivered: NDArray[np.int64]
    """[envs, robots] pellets delivered in the episode up to this step."""
    collided: NDArray[np.bool_]
    """[envs, robots] touched another robot under way in this step."""
    blocked: NDArray[np.bool_]
    """[envs, robots] under way, in touch with something, and hardly moved in this step; or whose move was
    refused in the grid, or who was held back at `keep_distance`."""


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot(EqualByValue):
    """A moment of a batch of environments: their seeds, and the actions since the episode began.

    The solver keeps contacts and forces inside that no copy carries over to the last bit, so a moment is
    restored by running to it again.
    """

    seeds: tuple[int, ...]
    episode: int
    actions: NDArray[np.uint8]
    """[decisions, envs, robots]."""

    def require_size(self, num_envs: int, robots: int) -> None:
        """Raise InputError unless it is a moment of so many environments with so many robots."""
        held = self.actions.shape[1:]
        if held != (num_envs, robots):
            raise InputError(
                f"snapshot: it holds [envs, robots] = {list(held)}, "
                f"this environment has [{num_envs}, {robots}]."
            )


class VectorEnv:
    """Several copies of one arena with a team of robots each, stepped together.

    Copies differ only by their seed, and each gives the same trajectory as it would alone. All
    episodes have the same length, so they end together; with `autoreset` the next ones begin at
    once. Observations are float32 [envs, robots, size], actions integers [envs, robots] from 0 to
    `num_actions` - 1.
    """

    def __init__(
        self,
        base: EnvConfig | Arena | str | Path | None = None,
        *,
        num_envs: int = 1,
        seed: int | Sequence[int] = 0,
        autoreset: bool = True,
        **fields: Any,
    ) -> None:
        """Read the arena and set up its worlds; nothing runs before `reset`.

        `base` is a configuration or an arena, `fields` replace fields of it: see `env_config`. `seed` is one
        number from which each environment gets its own, or one number for each environment. Raises
        InputError for values out of range.
        """
        self.config, arena = env_config(base, **fields)
        """What the environment is; with the arena's text."""
        self.num_envs = whole_number("num_envs", num_envs, 1, MAX_ENVS)
        if not isinstance(autoreset, bool):
            raise refused("autoreset", autoreset, "true or false")
        self.autoreset = autoreset
        self.seeds = self.seeds_from(seed)
        config = self.config
        self.robots = config.robots
        self.layout = config.layout_in(arena)
        self.num_actions = self.layout.num_actions
        self._check_memory(arena)
        profile = config.profile or ProfileConfig()
        self._world = make_world(
            config.world,
            arena,
            config.robots,
            self.num_envs,
            config.actions,
            config.pellet_gradient,
            profile.motion,
            config.keep_distance,
        )
        self.arena = self._world.arena
        """The map, with the timing of the world."""
        self.episode_steps = config.episode_steps or self.arena.timing.episode_steps
        sensor = make_sensor(profile.sensing, self._world)
        self._dec = DecPomdp(
            self._world, self.layout, config.reward, config.pheromone, sensor, profile.pheromones
        )
        self.episode = -1
        """Episodes begun before the current one; -1 before the first reset."""
        self.steps_taken = 0
        """Decisions in the current episode."""
        self.delivered = np.zeros((self.num_envs, self.robots), dtype=np.int64)
        """[envs, robots] pellets delivered by each robot in the current episode."""
        self.handed_over = np.zeros((self.num_envs, self.robots), dtype=np.int64)
        """[envs, robots] pellets that each robot handed over in the current episode."""
        self._reward = np.zeros((self.num_envs, self.robots), dtype=np.float32)
        self._busy = False
        self._torn = False
        """Whether a decision was broken off in its midst, by Ctrl-C or an error."""
        self._history = np.empty((0, self.num_envs, self.robots), dtype=np.uint8)

    def _check_memory(self, arena: Arena) -> None:
        """Raise InputError for more numbers than a machine should hold, in observations or pheromone maps."""
        size, envs, robots = self.layout.size, self.num_envs, self.robots
        if size * envs * robots > MOST_NUMBERS:
            raise InputError(
                f"num_envs is {envs}, but must be at most {max(1, MOST_NUMBERS // (size * robots))} with "
                f"{robots} robots and {size} numbers in an observation (pheromone_radius says how many)."
            )
        radius = self.config.pheromone.radius
        cells = len(CHANNELS) * (arena.rows + 2 * radius) * (arena.columns + 2 * radius)
        if cells * envs > MOST_NUMBERS:
            raise InputError(
                f"num_envs is {envs}, but must be at most {max(1, MOST_NUMBERS // cells)} with {cells} "
                "numbers in a map of pheromones (pheromone_radius adds a margin on every side)."
            )

    @property
    def joint_decisions(self) -> int:
        """Joint decisions that a step takes: one in each environment."""
        return self.num_envs

    @property
    def world(self) -> World:
        """Where the robots and pellets are: for controllers with full knowledge, reports and tests."""
        return self._world

    @property
    def dec_pomdp(self) -> DecPomdp:
        """Modes, collisions and pheromones."""
        return self._dec

    @property
    def drawn(self) -> tuple[MotionDraws, ...] | None:
        """[envs] what the present episodes have drawn from the profile; None without one, before a reset."""
        return tuple(self._world.drawn) if self.config.profile is not None and self.episode >= 0 else None

    def reset(self, seed: int | Sequence[int] | None = None) -> NDArray[np.float32]:
        """Begin new episodes; returns the observations [envs, robots, size].

        With `seed` the environments are seeded anew and their first episode begins; without, the
        next one of the same seeds.
        """
        with self._alone("reset"):
            if seed is not None:
                self.seeds = self.seeds_from(seed)
                self.episode = -1
            return self._begin(self.episode + 1)

    @contextlib.contextmanager
    def _alone(self, what: str) -> Iterator[None]:
        """Raise InputError where another thread is in the midst of a decision."""
        if self._busy:
            raise InputError(f"{what}: {OTHER_THREAD}")
        self._busy = True
        try:
            yield
        finally:
            self._busy = False

    def _require_whole(self, what: str) -> None:
        """Raise InputError where a decision or the beginning of an episode was broken off in its midst."""
        if self._torn:
            raise InputError(
                f"{what}: a decision was interrupted, and the environment is in its midst; call reset or "
                "restore."
            )

    def _begin(self, episode: int) -> NDArray[np.float32]:
        self._torn = True
        self.episode = episode
        self._world.reset([np.random.SeedSequence(seed, spawn_key=(episode,)) for seed in self.seeds])
        # Of their own: whether sensors draw must not change what the world draws.
        sensing = [np.random.SeedSequence(seed, spawn_key=(episode, SENSING)) for seed in self.seeds]
        self._dec.reset(self._world.state, sensing)
        self.steps_taken = 0
        self.delivered = np.zeros_like(self.delivered)
        self.handed_over = np.zeros_like(self.handed_over)
        self._reward = np.zeros_like(self._reward)
        if len(self._history) < self.episode_steps:
            # Grows with use, for an episode may be set so long that it never ends.
            self._history = np.empty((min(self.episode_steps, 1024), self.num_envs, self.robots), np.uint8)
        observation = self._dec.observe()
        self._torn = False
        return observation

    def step(self, actions: ArrayLike) -> Transition:
        """Advance every environment by one decision with actions [envs, robots]; see `Transition`.

        Raises InputError for actions of the wrong shape, kind or range, before the first reset, after the
        end of an episode when `autoreset` is off, and while another thread is at it.
        """
        with self._alone("step"):
            return self._step(actions)

    def _step(self, actions: ArrayLike) -> Transition:
        chosen = checked_actions(actions, (self.num_envs, self.robots), self.num_actions)
        if self.episode < 0:
            raise InputError("step: no episode has begun; call reset first.")
        self._require_whole("step")
        if self.steps_taken >= self.episode_steps:
            raise InputError(
                f"step: the episode has ended after {self.episode_steps} decisions; "
                "call reset to begin another."
            )
        world, dec = self._world, self._dec
        if self.steps_taken == len(self._history):
            grown = np.empty((2 * len(self._history), self.num_envs, self.robots), np.uint8)
            grown[: self.steps_taken] = self._history
            self._history = grown
        self._history[self.steps_taken] = chosen
        self._torn = True
        world.step(chosen, dec.gripper_commands(), dec.believed)
        self._reward = dec.update(chosen, world.state).astype(np.float32)
        self.delivered = self.delivered + world.state.deliveries
        if dec.truth.hands_over is not None:
            self.handed_over = self.handed_over + dec.truth.handed_over
        self.steps_taken += 1
        final = dec.observe()
        self._torn = False
        # Before the next episode begins and clears them.
        delivered, reward, truth = self.delivered, self._reward, dec.truth
        collided, blocked = truth.collided, truth.blocked
        ended = self.steps_taken == self.episode_steps
        observation = self._begin(self.episode + 1) if ended and self.autoreset else final
        return Transition(
            observation,
            reward,
            np.zeros(self.num_envs, dtype=np.bool_),
            np.full(self.num_envs, ended),
            final.copy() if observation is final else final,
            delivered.copy(),
            collided,
            blocked,
        )

    def close(self) -> None:
        """Do nothing: there are no processes to end, as where `workers` is above 1."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frame(self, env: int = 0) -> Frame:
        """Return what there is to see of one environment; its arrays are views, valid until the next step.

        Raises InputError before the first reset, and for an environment that there is not.
        """
        env = self._begun("frame", env)
        world, dec, state = self._world, self._dec, self._world.state
        contacts = world.contacts
        return Frame(
            step=self.steps_taken,
            time=self.steps_taken * self.arena.timing.decision_period,
            pose=state.pose[env],
            mode=dec.shown_mode[env],
            laden=state.held[env] >= 0,
            action=dec.previous_action[env],
            reward=self._reward[env],
            pellets=state.pellets[env],
            pellet_status=state.pellet_status[env],
            delivered=self.delivered[env],
            energy=world.wheel_energy[env],
            closest=world.closest[env],
            density=float(dec.density[env]),
            pheromone=dec.pheromone.occupancy[env],
            contacts=contacts if self.num_envs == 1 else contacts.of_env(env),
        )

    def snapshot(self) -> Snapshot:
        """Return the present moment, to be restored into an environment of the same kind.

        Raises InputError before the first reset.
        """
        if self.episode < 0:
            raise InputError("snapshot: no episode has begun; call reset first.")
        self._require_whole("snapshot")
        return Snapshot(self.seeds, self.episode, self._history[: self.steps_taken].copy())

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Return to a moment, exact to the last bit, by running to it again; returns the observations.

        Raises InputError for a snapshot of another batch size, or longer than an episode.
        """
        require_snapshot(snapshot)
        snapshot.require_size(self.num_envs, self.robots)
        if len(snapshot.actions) > self.episode_steps:
            raise InputError(
                f"snapshot: it holds {len(snapshot.actions)} decisions, "
                f"an episode here has {self.episode_steps}."
            )
        self.seeds = snapshot.seeds
        autoreset, self.autoreset = self.autoreset, False
        try:
            observation = self._begin(snapshot.episode)
            for actions in snapshot.actions:
                observation = self.step(actions).observation
        finally:
            self.autoreset = autoreset
        return observation

    def trajectory(self, env: int = 0, *, policy: str = "") -> Trajectory:
        """Return the current episode of one environment so far, as seed and actions; `policy` chose them.

        Raises InputError before the first reset, and for an environment that there is not.
        """
        env = self._begun("trajectory", env)
        return Trajectory(
            config=self.config,
            seed=self.seeds[env],
            episode=self.episode,
            chosen=self._history[: self.steps_taken, env].copy(),
            policy=policy,
            drawn=None if self.drawn is None else self.drawn[env].table(),
        )

    def _begun(self, what: str, env: int) -> int:
        if self.episode < 0:
            raise InputError(f"{what}: no episode has begun; call reset first.")
        self._require_whole(what)
        return whole_number(f"{what}: env", env, 0, self.num_envs - 1)

    def _repr_html_(self) -> str:
        from robosim.envs.picture import moment_html

        return moment_html(self)

    def seeds_from(self, seed: int | Sequence[int]) -> tuple[int, ...]:
        """Return the seed of each environment, for one number or one each; InputError for anything else."""
        return env_seeds(seed, self.num_envs)


def require_snapshot(snapshot: object) -> None:
    """Raise InputError unless it is a `Snapshot`."""
    if not isinstance(snapshot, Snapshot):
        raise refused("snapshot", snapshot, "what `snapshot` returned")


def plain_seed(seed: Any) -> Any:
    """Return the number in an array without axes, and anything else as it is."""
    return seed.item() if isinstance(seed, np.ndarray) and seed.ndim == 0 else seed


def env_seeds(seed: int | Sequence[int], num_envs: int) -> tuple[int, ...]:
    """Return the seed of each environment, for one number or one each; InputError for anything else."""
    seed = plain_seed(seed)
    if not isinstance(seed, (list, tuple, range, np.ndarray)):
        root = np.random.SeedSequence(whole_number("seed", seed, 0, MAX_SEED))
        return tuple(int(one) for one in root.generate_state(num_envs, np.uint64))
    seeds = tuple(whole_number("seed", one, 0, MAX_SEED) for one in seed)
    if len(seeds) != num_envs:
        raise InputError(
            f"seed has {len(seeds)} numbers, but must be one, or one for each of {num_envs} envs."
        )
    return seeds


def actions_in_rows(actions: ArrayLike, rows: int) -> NDArray[Any]:
    """Return actions as an array [rows], of faces whose rows are robots; InputError for another shape."""
    array = np.asarray(actions)
    if array.shape != (rows,):
        raise InputError(f"actions has the shape {list(array.shape)}, but must be [{rows}].")
    return array


def checked_actions(actions: ArrayLike, shape: tuple[int, int], num_actions: int) -> NDArray[np.int64]:
    """Return actions as integers of `shape` [envs, robots]; InputError for another shape, kind or range."""
    allowed = f"whole numbers from 0 to {num_actions - 1}, [envs, robots] = {list(shape)}"
    try:
        array = np.asarray(actions)
    except ValueError:
        raise InputError(f"actions has rows of unequal length, but must be {allowed}.") from None
    if array.shape != shape:
        raise InputError(f"actions has the shape {list(array.shape)}, but must be {allowed}.")
    if array.dtype.kind not in "iu":
        raise InputError(f"actions is of type {array.dtype}, but must be {allowed}.")
    if array.min() < 0 or array.max() >= num_actions:
        wrong = int(array[(array < 0) | (array >= num_actions)][0])
        raise InputError(f"actions holds {wrong}, but must be {allowed}.")
    return array.astype(np.int64)
