"""The networks of teams as they learn: parts, joints, and robots that act without learning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import Networks
from robosim.discretise.observation import Columns, MoveGains
from robosim.errors import InputError
from robosim.learning.algorithms.protocol import Actors


def expanded(actors: Actors) -> Actors:
    """Return the same team with a network stored for each robot, also where several run one."""
    spec, weights = actors
    chosen = list(spec.of_robot)
    fresh = {name: np.asarray(array, np.float32)[chosen] for name, array in weights.items()}
    return Actors(spec.changed(of_robot=tuple(range(len(chosen))), precision="float32"), fresh)


def robots_of(actors: Actors, first: int, last: int) -> Actors:
    """Return robots `first` to `last - 1` of a team, with a network stored for each."""
    whole = expanded(actors)
    weights = {name: array[first:last] for name, array in whole.weights.items()}
    return Actors(whole.spec.changed(of_robot=tuple(range(last - first))), weights)


def joined(before: Actors | None, after: Actors) -> Actors:
    """Return two teams as one, those of `before` first; each keeps its networks.

    InputError for networks that differ in shape, or that see the whole team.
    """
    if before is None:
        return after
    first, second = before.spec, after.spec
    kinds = [spec.model_dump(exclude={"of_robot"}) for spec in (first, second)]
    if kinds[0] != kinds[1] or first.input == "team":
        raise InputError(
            "curriculum is true, but must be false for networks that differ between stages or see the whole "
            "team."
        )
    of_robot = first.of_robot + tuple(first.networks + one for one in second.of_robot)
    weights = {name: np.concatenate((array, after.weights[name])) for name, array in before.weights.items()}
    return Actors(first.changed(of_robot=of_robot), weights)


class FrozenTeam:
    """Robots that act by what they have learned, without exploration, and learn no more."""

    def __init__(self, actors: Actors, gains: MoveGains | None = None) -> None:
        """`gains` is where observations hold the gains of moves, for networks with a mask."""
        self.robots = actors.spec.robots
        self._networks = Networks(actors.spec, actors.weights, Columns(gains))

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return actions [envs, robots] for `observation` [envs, robots, size]: those of their policy."""
        return self._networks.act(observation)
