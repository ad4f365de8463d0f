"""Measure any controller: whole episodes without exploration, side by side in a batch of environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from robosim.control.card import Evaluation
from robosim.control.seek import require_world
from robosim.errors import refused, whole_number

if TYPE_CHECKING:
    from robosim.control.controller import Controller
    from robosim.envs.vector import VectorEnv


MOST_EPISODES = 10_000
"""Of an evaluation."""


class Watch(Protocol):
    """Sees every decision of an evaluation; the environment is to be read only."""

    def begin(self, env: VectorEnv) -> None:
        """Hear that a round of episodes has begun."""
        ...

    def step(self, env: VectorEnv) -> None:
        """Hear that a decision has been taken in all of them."""
        ...

    def end(self, env: VectorEnv, wanted: int) -> None:
        """Hear that they are over; the first `wanted` of them count."""
        ...


def evaluate(
    controller: Controller, env: VectorEnv, episodes: int, seed: int = 0, watch: Sequence[Watch] = ()
) -> Evaluation:
    """Run `episodes` whole episodes and return what the team delivered in each.

    They run `env.num_envs` at a time; surplus ones of the last round are left out. Equal arguments give
    equal results. InputError for a number of episodes out of range, and from the controller when it does not
    fit the environment.
    """
    whole_number("episodes", episodes, 1, MOST_EPISODES)
    if not hasattr(controller, "act"):
        raise refused("controller", controller, "a controller, as robosim.make_controller makes one by name")
    require_world("evaluate", env)
    delivered: list[tuple[int, ...]] = []
    handed_over: list[tuple[int, ...]] = []
    collisions: list[int] = []
    closest: list[float] = []
    lapses: list[int] = []
    env.world.meter()
    team = env.world.team
    # Who watches reads the last decision after it, so the next episode must not begin by itself.
    autoreset, env.autoreset = env.autoreset, False
    try:
        while len(delivered) < episodes:
            observation = env.reset(seed=None if delivered else seed)
            controller.reset(env)
            for one in watch:
                one.begin(env)
            collided, total, last, lapse = np.zeros((4, env.num_envs), dtype=np.int64)
            for step in range(1, env.episode_steps + 1):
                transition = env.step(controller.act(env, observation))
                observation = transition.final_observation
                collided += transition.collided.sum(axis=1)
                np.maximum(lapse, step - last, out=lapse)
                before, total = total, env.delivered.sum(axis=1)
                last[total > before] = step
                for one in watch:
                    one.step(env)
            for one in watch:
                one.end(env, min(env.num_envs, episodes - len(delivered)))
            delivered += [tuple(map(int, robots)) for robots in env.delivered]
            handed_over += [tuple(map(int, robots)) for robots in env.handed_over]
            collisions += map(int, collided)
            closest += map(float, env.world.closest.min(axis=1))
            lapses += map(int, lapse)
    finally:
        env.autoreset = autoreset
    return Evaluation(
        controller=controller.name,
        arena=env.arena.name,
        world=env.config.world,
        robots=env.robots,
        episode_steps=env.episode_steps,
        seed=seed,
        delivered=tuple(delivered[:episodes]),
        collisions=tuple(collisions[:episodes]),
        profile=env.config.profile,
        closest=tuple(closest[:episodes]) if env.robots > 1 else None,
        longest_lapse=tuple(lapses[:episodes]),
        groups=team.names if team.mixed else None,
        handed_over=None if team.all_round else tuple(handed_over[:episodes]),
    )
