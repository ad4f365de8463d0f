"""How near robots come to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def to_nearest(pose: Floats) -> Floats:
    """Return how far off the centre of the nearest other robot is, [envs, robots] m; infinite for one alone.

    `pose` is [envs, robots, 3].
    """
    return closest_on_the_path(pose, pose)


def closest_on_the_path(before: Floats, after: Floats) -> Floats:
    """Return the least distance to another robot's centre while all go from one pose to the next.

    Poses are [envs, robots, 3], distances [envs, robots] m; robots go straight and at constant speed in
    between, at the same time. Infinite for one alone.
    """
    start = before[:, :, None, :2] - before[:, None, :, :2]
    change = after[:, :, None, :2] - after[:, None, :, :2] - start
    length = (change * change).sum(axis=-1)
    # The share of the path at which a pair is closest; a pair without relative motion is so at once.
    share = -(start * change).sum(axis=-1) / np.where(length > 0.0, length, 1.0)
    apart = start + np.clip(share, 0.0, 1.0)[..., None] * change
    distance = np.hypot(apart[..., 0], apart[..., 1])
    robots = np.arange(before.shape[1])
    distance[:, robots, robots] = np.inf
    return np.asarray(distance.min(axis=2))
