"""Independent advantage actor-critics (I-A2C): each robot an actor and a critic of its own observation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from robosim.learning.algorithms.actor_critic import AdvantageActorCritic, OwnActorsConfig, own_actors
from robosim.learning.algorithms.protocol import Actors, Task


class Ia2cConfig(OwnActorsConfig):
    """Independent advantage actor-critic."""

    name: Literal["ia2c"] = "ia2c"
    """Of the algorithm."""

    def build(
        self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> AdvantageActorCritic:
        return AdvantageActorCritic(self, task, seed, start, own_actors(self, task))
