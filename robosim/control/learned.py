"""A trained policy as a controller, checked against the environment that it is to drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robosim.control.policy import Policy
from robosim.errors import InputError

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv


class LearnedController:
    """Drives a team by its trained networks, without exploration."""

    def __init__(self, policy: Policy, name: str) -> None:
        self.policy = policy
        self.name = name

    def reset(self, env: VectorEnv) -> None:
        """Check that the policy fits `env`; InputError in one sentence that says what differs."""
        check_fit(self.policy, env, self.name)

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return actions [envs, robots] from `observation` [envs, robots, size]."""
        return self.policy.act(observation)


def check_fit(policy: Policy, env: VectorEnv, name: str) -> None:
    """Raise InputError, in one sentence, if `policy` was not trained for such an environment."""
    card, arena, layout = policy.card, env.arena, env.layout
    differences = [
        (what, trained, given)
        for what, trained, given in (
            *((("robots", card.robots, env.robots),) if not card.shared else ()),
            ("actions", card.actions, layout.actions),
            ("number of actions", card.num_actions, env.num_actions),
            ("observation encoding", card.observation.encoding, layout.encoding),
            ("stigmergy", card.observation.stigmergy, layout.stigmergy),
            *(
                (f"pheromone {field}", value, getattr(env.config.pheromone, field))
                for field, value in card.observation.pheromone.model_dump().items()
                if card.observation.stigmergy
            ),
            ("cell size (m)", card.arena.cell_size, arena.cell_size),
            ("decision period (s)", card.timing.decision_period, arena.timing.decision_period),
            *(
                (f"robot {field}", value, getattr(arena.robot, field))
                for field, value in card.robot.model_dump().items()
            ),
        )
        if trained != given
    ]
    if not differences and card.observation.names != tuple(layout.names):
        pairs = zip(card.observation.names, layout.names, strict=False)
        first = next((i for i, (one, other) in enumerate(pairs) if one != other), None)
        if first is None:
            differences = [("observation size", len(card.observation.names), layout.size)]
        else:
            differences = [(f"observation entry {first}", card.observation.names[first], layout.names[first])]
    if differences:
        told = "; ".join(
            f"{what} was {trained} in training and is {given} here" for what, trained, given in differences
        )
        raise InputError(f"policy {name} does not fit arena {arena.name!r}: {told}.")
