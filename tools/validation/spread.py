"""simple_spread of mpe2 (Lowe 2017; three agents, three landmarks, discrete actions), many at a time.

mpe2 steps one environment in Python objects. This is the same arithmetic on arrays [envs, robots, ...];
`difference_to_mpe2` steps both side by side and says how far apart they come.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROBOTS = 3
SIZE = 4 + 2 * ROBOTS + 4 * (ROBOTS - 1)
"""Numbers in an observation: own velocity and position, landmarks, the others, what they say (nothing)."""
ACTIONS = 5
EPISODE = 25
"""Decisions of an episode, which then is cut off."""
LOCAL_RATIO = 0.5
"""Share of a robot's own collisions in its reward; the rest is how well the team covers the landmarks."""

_PUSH = 5.0 * np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]], dtype=np.float64)
_TIME_STEP, _DAMPING = 0.1, 0.25
_CONTACT_FORCE, _CONTACT_MARGIN, _CONTACT_DISTANCE = 100.0, 1e-3, 0.3

Act = Callable[[NDArray[np.float32], bool], NDArray[np.int64]]
"""From observations [envs, robots, size], and whether episodes begin with them, to actions [envs, robots]."""


class Step(NamedTuple):
    """What came of a decision in every environment."""

    observation: NDArray[np.float32]
    """[envs, robots, size] of the next episode, where one has ended."""
    reward: NDArray[np.float32]
    """[envs, robots]."""
    final_observation: NDArray[np.float32]
    """[envs, robots, size] what the decision led to."""
    truncated: bool
    """The episodes, all of which are equally long, were cut off."""


class Spread:
    """Environments side by side; their episodes begin and end together."""

    def __init__(self, num_envs: int, seed: int | None = None) -> None:
        self.num_envs = num_envs
        self.returns: list[float] = []
        """Sum of the rewards of each round of episodes, mean over robots and environments."""
        self._rng = np.random.default_rng(seed)

    def reset(self, seeds: Sequence[int] | None = None) -> NDArray[np.float32]:
        """Begin new episodes, with `seeds` those that mpe2 begins with the same; return observations."""
        shape = (2 * ROBOTS, 2)
        if seeds is None:
            places = self._rng.uniform(-1, 1, (self.num_envs, *shape))
        else:
            places = np.stack([np.random.default_rng(seed).uniform(-1, 1, shape) for seed in seeds])
        self._position, self._landmark = places[:, :ROBOTS].copy(), places[:, ROBOTS:].copy()
        self._velocity = np.zeros_like(self._position)
        self._step, self._return = 0, 0.0
        return self._observe()

    def step(self, actions: NDArray[np.int64]) -> Step:
        """Take a decision, actions [envs, robots], in every environment."""
        force = _PUSH[actions] + _contact_forces(self._position)
        self._position += self._velocity * _TIME_STEP
        self._velocity = self._velocity * (1 - _DAMPING) + force * _TIME_STEP
        reward = self._reward()
        self._return += float(reward.mean())
        self._step += 1
        final = self._observe()
        ended = self._step == EPISODE
        if ended:
            self.returns.append(self._return)
        return Step(self.reset() if ended else final, reward.astype(np.float32), final, ended)

    def _reward(self) -> NDArray[np.float64]:
        to_landmarks = np.linalg.norm(self._landmark[:, :, None] - self._position[:, None], axis=-1)
        uncovered = to_landmarks.min(axis=2).sum(axis=1)
        between = np.linalg.norm(self._position[:, :, None] - self._position[:, None], axis=-1)
        collisions = (between < _CONTACT_DISTANCE).sum(axis=2) - 1
        return np.asarray(-(1 - LOCAL_RATIO) * uncovered[:, None] - LOCAL_RATIO * collisions)

    def _observe(self) -> NDArray[np.float32]:
        landmarks = self._landmark[:, None] - self._position[:, :, None]
        others = (self._position[:, None] - self._position[:, :, None])[:, ~np.eye(ROBOTS, dtype=np.bool_)]
        shape = (self.num_envs, ROBOTS, -1)
        parts = (self._velocity, self._position, landmarks.reshape(shape), others.reshape(shape))
        silence = np.zeros((self.num_envs, ROBOTS, 2 * (ROBOTS - 1)))
        return np.concatenate((*parts, silence), axis=-1, dtype=np.float32, casting="same_kind")


def _contact_forces(position: NDArray[np.float64]) -> NDArray[np.float64]:
    apart = position[:, :, None] - position[:, None]
    distance = np.linalg.norm(apart, axis=-1)
    distance[:, np.eye(ROBOTS, dtype=np.bool_)] = np.inf
    overlap = np.logaddexp(0, (_CONTACT_DISTANCE - distance) / _CONTACT_MARGIN) * _CONTACT_MARGIN
    along = _CONTACT_FORCE * apart / distance[..., None] * overlap[..., None]
    return np.asarray(along.sum(axis=2))


def evaluate(act: Act, episodes: int, first_seed: int) -> list[float]:
    """Return the mean of the robots' returns in each of so many episodes, which mpe2's seeds begin."""
    env = Spread(episodes)
    observation = env.reset(range(first_seed, first_seed + episodes))
    total = np.zeros(episodes)
    for decision in range(EPISODE):
        step = env.step(act(observation, decision == 0))
        total += step.reward.mean(axis=1)
        observation = step.observation
    return [float(one) for one in total]


def difference_to_mpe2(episodes: int, seed: int) -> float:
    """Return the largest difference of any observation or reward to mpe2's, over whole episodes at random."""
    from mpe2 import simple_spread_v3

    theirs = simple_spread_v3.parallel_env(N=ROBOTS, local_ratio=LOCAL_RATIO, max_cycles=EPISODE)
    ours, rng, most = Spread(1), np.random.default_rng(seed), 0.0
    ended: dict[str, bool] = {}
    for episode in range(episodes):
        seen, _ = theirs.reset(seed=seed + episode)
        observation = ours.reset([seed + episode])
        for _ in range(EPISODE):
            most = max(most, np.abs(np.stack(list(seen.values())) - observation[0]).max())
            actions = rng.integers(ACTIONS, size=(1, ROBOTS))
            names = list(seen)
            seen, rewards, _, ended, _ = theirs.step(dict(zip(names, actions[0].tolist(), strict=True)))
            step = ours.step(actions)
            observation = step.final_observation
            most = max(most, np.abs(np.array(list(rewards.values())) - step.reward[0]).max())
        if not all(ended.values()):
            raise RuntimeError(f"an episode of mpe2 is longer than {EPISODE} decisions")
    return float(most)
