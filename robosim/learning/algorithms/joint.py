"""The team as a single robot: it sees what all see, and its actions are the combinations of theirs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import MOST_OUTPUTS
from robosim.learning.algorithms.protocol import Experience


def most_robots(num_actions: int) -> int:
    """Return how many robots may have a network with an output for each combination of their actions."""
    # The half lets a power that is the most itself count, however its logarithms are rounded.
    return int(np.log(MOST_OUTPUTS + 0.5) / np.log(num_actions))


def combine_actions(actions: NDArray[np.int64], digits: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number [...] of each combination of actions [..., robots], robot 0's the first digit."""
    return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(actions, -1, 0)), digits), np.int64)


def split_actions(combination: NDArray[np.int64], digits: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the actions [..., robots] of which `combine_actions` makes `combination` [...]."""
    return np.stack(np.unravel_index(combination, digits), axis=-1)


def as_one(observation: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return [envs, robots, size] as [envs, 1, robots * size]."""
    return observation.reshape(len(observation), 1, -1)


def experience_as_one(experience: Experience, digits: tuple[int, ...]) -> Experience:
    """Return what the team experienced, paid the mean of its robots' rewards."""
    return experience._replace(
        observation=as_one(experience.observation),
        action=combine_actions(experience.action, digits)[:, None],
        reward=experience.reward.mean(axis=1, keepdims=True),
        final_observation=as_one(experience.final_observation),
        next_observation=as_one(experience.next_observation),
    )
