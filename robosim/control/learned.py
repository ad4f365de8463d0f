"""A trained policy as a controller, checked against the environment that it is to drive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.arena.schema import RobotSection
from robosim.control.card import PolicyCard, arena_card
from robosim.control.player import Player
from robosim.control.policy import Policy
from robosim.discretise.observation import ObservationLayout
from robosim.envs.config import EnvConfig
from robosim.errors import InputError, shown

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv


class Team(Protocol):
    """What a policy is checked against, in simulation or not."""

    config: EnvConfig
    arena: Arena
    """With the timing by which the team decides."""
    robots: int
    layout: ObservationLayout


class LearnedController:
    """Drives a team by its trained networks, without exploration."""

    def __init__(self, policy: Policy, name: str) -> None:
        self.policy = policy
        self.name = name
        self._player = Player(policy.act, policy.card.network)
        self._decision = 0

    def reset(self, env: VectorEnv) -> None:
        """Check that the policy fits `env`; InputError in one sentence that says what differs."""
        check_fit(self.policy.card, env, self.name)
        self._decision = 0

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return actions [envs, robots] from `observation` [envs, robots, size]."""
        decision, self._decision = self._decision, self._decision + 1
        return self._player.act(observation, decision)


def check_fit(card: PolicyCard, team: Team, name: str) -> None:
    """Raise InputError, in one sentence, if a policy of that card was not trained for such a team.

    It may drive robots in another world than the one in which it learned, at the pace of that world.
    """
    numbers, bodies = _differences(_numbers(card, team)), _differences(_bodies(card, team))
    # Whoever has other robots would like to know what to do.
    end = "" if numbers or not bodies else "; to train a team for what is here, go on from it by --start-from"
    _refuse(numbers + bodies or _observations(card, team), team, name, end)


def check_start(card: PolicyCard, team: Team, name: str) -> None:
    """Raise InputError, in one sentence, if a team cannot go on learning from a policy of that card.

    Observations and actions must be the same numbers; other bodies, cells and clocks are there to be learned.
    """
    _refuse(_differences(_numbers(card, team)) or _observations(card, team), team, name)


def _refuse(differences: Sequence[str], team: Team, name: str, end: str = "") -> None:
    if differences:
        raise InputError(
            f"policy {name} does not fit arena {team.arena.name!r}: {'; '.join(differences)}{end}."
        )


def _differences(facts: Iterable[tuple[str, object, object]]) -> list[str]:
    return [
        f"{what} was {trained} in training and is {given} here"
        for what, trained, given in facts
        if trained != given
    ]


def _numbers(card: PolicyCard, team: Team) -> Iterator[tuple[str, object, object]]:
    """Yield what numbers of observations and actions mean: what it is, in training, and here."""
    config = team.config
    if not card.network.shared:
        yield "robots", card.robots, team.robots
    yield "actions", card.env.actions, config.actions
    yield "number of actions", card.network.actions, team.layout.num_actions
    yield "observation encoding", card.env.encoding, config.encoding
    yield "free neighbours", card.env.neighbours, config.neighbours
    yield "stigmergy", card.env.stigmergy, config.stigmergy
    if card.env.stigmergy:
        for field, value in card.env.pheromone.model_dump().items():
            yield f"pheromone {field}", value, getattr(config.pheromone, field)
    trained, given = (
        [(one.name, one.role, one.count) for one in groups or ()]
        for groups in (card.arena.groups, arena_card(team.arena).groups)
    )
    yield "groups of robots", trained, given


def _bodies(card: PolicyCard, team: Team) -> Iterator[tuple[str, object, object]]:
    """Yield what moves, on what and how often: what it is, in training, and here."""
    here = arena_card(team.arena)
    yield "cell size (m)", card.arena.cell_size, here.cell_size
    if card.env.world == team.config.world:
        yield "decision period (s)", card.arena.timing.decision_period, here.timing.decision_period
    if card.arena.groups is None and here.groups is None:
        yield from _sheets("robot", card.arena.robot, here.robot)
    for one, other in zip(card.arena.groups or (), here.groups or (), strict=False):
        yield from _sheets(f"robot of {one.name}", one.robot, other.robot)


def _sheets(what: str, trained: RobotSection, given: RobotSection) -> Iterator[tuple[str, object, object]]:
    for field, value in trained.model_dump().items():
        yield f"{what} {field}", value, getattr(given, field)


def _observations(card: PolicyCard, team: Team) -> list[str]:
    """Return how the first numbers of an observation that differ do, if any do."""
    trained, given = card.observation, team.layout.names
    for place, (one, other) in enumerate(zip(trained, given, strict=False)):
        if one != other:
            # The card may come from a stranger: what it says must not steer a terminal.
            return [f"observation entry {place} was {shown(one)} in training and is {shown(other)} here"]
    if len(trained) != len(given):
        return [f"observation size was {len(trained)} in training and is {len(given)} here"]
    return []
