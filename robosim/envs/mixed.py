"""Teams of several sizes in several arenas as one batch, for one network that all robots run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robosim.arena import Arena, load_arena
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.variety import VarietyConfig, require_alike
from robosim.envs.vector import (
    MAX_ENVS,
    Snapshot,
    Transition,
    VectorEnv,
    checked_actions,
    env_seeds,
    require_snapshot,
)
from robosim.errors import InputError, whole_number
from robosim.world.factory import room_in

_OF_ENVS = ("terminated", "truncated")
"""Fields of a transition that are [envs]."""


class MixedVectorEnv:
    """Environments with arenas and team sizes of their own, stepped together.

    To a learner each robot is an environment with one robot: arrays are [rows, 1, ...], the robots of one
    environment one after another. All episodes have the same length, so they end together, and the next
    ones begin at once, in arenas drawn anew where `variety.redraw` says so.
    """

    robots = 1

    def __init__(
        self, base: EnvConfig, variety: VarietyConfig, *, num_envs: int, seed: int | Sequence[int] = 0
    ) -> None:
        """Set up the groups; `base` says all but arena and robots. Nothing runs before `reset`.

        InputError where an arena differs from that of `base` in more than its map and pellets, has too
        little room, or `num_envs` is no multiple of `envs_per_arena`.
        """
        self.config, arena = env_config(base)
        """As given, with the arena's text: what a policy's card says."""
        # With their texts: an arena is then read once, and not again with every episode.
        self.variety = variety.changed(arenas=tuple(load_arena(one).text for one in variety.arenas))
        self.joint_decisions = whole_number("num_envs", num_envs, 1, MAX_ENVS)
        if num_envs % variety.envs_per_arena:
            raise InputError(
                f"num_envs is {num_envs}, but must be a multiple of envs_per_arena, {variety.envs_per_arena}."
            )
        self.seeds = env_seeds(seed, num_envs)
        groups = num_envs // variety.envs_per_arena
        self.sizes = variety.sizes(groups, self.seeds)
        """[groups] robots in each environment of a group."""
        for one in map(load_arena, self.variety.arenas):
            require_alike(one, arena)
            if (room := self._room(one)) < max(self.sizes):
                raise InputError(
                    f"arenas: {one.name} has room for {room} robots, but must have room for "
                    f"{max(self.sizes)}, as team_sizes says."
                )
        if variety.random_arenas:
            require_alike(load_arena(variety.random(0, self._has_room)), arena)
        self.num_envs = variety.envs_per_arena * sum(self.sizes)
        """Rows of the batch: robots of all environments together."""
        sample = VectorEnv(self.config)
        self.layout = sample.layout
        self.num_actions = sample.num_actions
        self.arena = sample.arena
        """Of `base`, with the timing of its world."""
        self.episode_steps = sample.episode_steps
        self.episode = -1
        """Episodes begun before the current one; -1 before the first reset."""
        self.groups: list[VectorEnv] = []

    def reset(self) -> NDArray[np.float32]:
        """Begin the next episodes; returns the observations [rows, 1, size]."""
        return self._begin(self.episode + 1, np.empty((0, self.num_envs), np.uint8))

    def step(self, actions: ArrayLike) -> Transition:
        """Advance every environment by one decision with actions [rows, 1]; see `Transition`.

        Raises InputError for actions of the wrong shape, kind or range, and before the first reset.
        """
        chosen = checked_actions(actions, (self.num_envs, 1), self.num_actions)
        if not self.groups:
            raise InputError("step: no episode has begun; call reset first.")
        parts = [_of_rows(env.step(share)) for env, share in self._shared_out(chosen[:, 0])]
        ends = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _OF_ENVS}
        rest = (name for name in Transition._fields if name not in _OF_ENVS)
        transition = Transition(
            **ends, **{name: _joined([getattr(part, name) for part in parts]) for name in rest}
        )
        return transition._replace(observation=self.reset()) if transition.truncated[0] else transition

    def snapshot(self) -> Snapshot:
        """Return the present moment; its actions are [decisions, rows, 1]."""
        if not self.groups:
            raise InputError("snapshot: no episode has begun; call reset first.")
        parts = [
            env.snapshot().actions.reshape(env.steps_taken, env.num_envs * env.robots) for env in self.groups
        ]
        rows = np.concatenate(parts, axis=1)
        return Snapshot(self.seeds, self.episode, rows[..., None])

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Return to a moment, exact to the last bit, by running to it again; returns the observations.

        Raises InputError for a snapshot of another batch: the seeds say how many robots are where.
        """
        require_snapshot(snapshot)
        snapshot.require_size(self.num_envs, 1)
        if tuple(snapshot.seeds) != tuple(self.seeds):
            raise InputError(
                "snapshot: it is of other seeds than this batch, and seeds say how many robots are where."
            )
        self.groups = []
        return self._begin(snapshot.episode, snapshot.actions[..., 0])

    def _begin(self, episode: int, past: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Run an episode up to where the actions `past` [decisions, rows] lead."""
        redraw = self.variety.redraw
        if not self.groups or (redraw and episode // redraw != self.episode // redraw):
            self.groups = list(self._drawn(episode))
        self.episode = episode
        each = self.variety.envs_per_arena
        observations = []
        for number, (env, share) in enumerate(self._shared_out(past)):
            seeds = self.seeds[number * each : (number + 1) * each]
            observations.append(env.restore(Snapshot(seeds, episode, share)))
        return _joined(observations)

    def _room(self, arena: Arena) -> int:
        return room_in(self.config.world, arena, self.config.keep_distance)

    def _has_room(self, text: str) -> bool:
        """Whether the largest team fits a random arena: in the grid not in each, nor at a distance."""
        if self.config.world == "physics" and self.config.keep_distance is None:
            return True
        return self._room(load_arena(text)) >= max(self.sizes)

    def _drawn(self, episode: int) -> Iterator[VectorEnv]:
        """Yield the groups of an episode."""
        arenas = self.variety.draw(len(self.sizes), self.seeds, episode, self._has_room)
        for arena, robots in zip(arenas, self.sizes, strict=True):
            yield VectorEnv(
                self.config,
                arena=arena,
                robots=robots,
                num_envs=self.variety.envs_per_arena,
                autoreset=False,
            )

    def _shared_out(self, rows: NDArray[Any]) -> Iterator[tuple[VectorEnv, NDArray[Any]]]:
        """Yield each group with its part of [..., rows], as [..., envs, robots]."""
        first = 0
        for env in self.groups:
            last = first + env.num_envs * env.robots
            yield env, rows[..., first:last].reshape(*rows.shape[:-1], env.num_envs, env.robots)
            first = last


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays [envs, robots, ...] of all groups as one, [rows, 1, ...]."""
    return np.concatenate([part.reshape(-1, 1, *part.shape[2:]) for part in parts])


def _of_rows(part: Transition) -> Transition:
    """Return a group's transition with what holds for an environment told of each of its robots."""
    robots = part.reward.shape[1]
    return part._replace(terminated=part.terminated.repeat(robots), truncated=part.truncated.repeat(robots))
