"""A policy's card: what it was trained on and how, and what its observations and actions mean."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from robosim.arena.model import Arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.discretise.pheromone import PheromoneConfig
from robosim.errors import InputError
from robosim.robot.drivers import NUM_ACTIONS

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv

FORMAT_VERSION = 1
"""Raised when a card's meaning changes; a reader refuses the versions that it does not know."""

_MOST_BYTES = 1_000_000

Text = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0.0)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class TechniqueCard(_Record):
    """How the policy learned, and what of it stays with the policy when it acts."""

    name: Text
    global_reward: bool
    stigmergy: bool
    curriculum: bool
    signed_distance: bool = False
    idle_cost: bool = False
    parameter_sharing: bool = False
    normalised: bool = False
    """Hidden layers are divided by their root mean square, after ReLU."""
    action_mask: bool = False
    """Closed ways are not chosen, as `robosim.discretise.observation.blocked_moves` tells them."""


class ArenaCard(_Record):
    """Where the policy learned."""

    name: Text
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    """Fingerprint of the arena file's text."""
    cell_size: float = Field(gt=0.0)
    """m."""


class PheromoneCard(_Record):
    """Constants of the pheromone map, as in `PheromoneConfig`, which checks them."""

    decay: float = PheromoneConfig().decay
    reinforcement: float = PheromoneConfig().reinforcement
    initial: float = PheromoneConfig().initial
    diffusion: float = PheromoneConfig().diffusion
    radius: int = PheromoneConfig().radius

    @property
    def config(self) -> PheromoneConfig:
        """The constants; InputError for values out of range."""
        return PheromoneConfig(**self.model_dump())


class ObservationCard(_Record):
    """What a robot's observation holds, in order."""

    encoding: Literal["paper", "expanded"]
    stigmergy: bool
    names: tuple[Text, ...] = Field(min_length=1, max_length=100_000)
    pheromone: PheromoneCard = PheromoneCard()


class NetworkCard(_Record):
    """Shape of each robot's network: ReLU after every layer but the last."""

    hidden: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field(min_length=1, max_length=8)
    precision: Literal["float32", "float16"] | None = None
    """Of the weights as stored; None where the card does not say. They are computed with in float32."""
    of_robot: tuple[Count, ...] = ()
    """[robots] which of the stored networks each robot runs, so that equal ones are stored once; empty for
    each its own."""

    @property
    def stored(self) -> int:
        """Networks in the file when `of_robot` is given; 0 otherwise."""
        return len(set(self.of_robot))

    @model_validator(mode="after")
    def _check_networks(self) -> Self:
        if sorted(set(self.of_robot)) != list(range(self.stored)):
            raise ValueError("of_robot must name every stored network, counted from 0")
        return self


class StageCard(_Record):
    """A part of the training in which the same robots learned."""

    name: Text
    robots: int = Field(ge=1)
    """In the tunnel."""
    learning: Count
    """How many of them learned; the others were frozen."""
    steps: Count
    """Joint decisions."""
    ended: Literal["steady", "budget"]
    """Whether the stage ended because its return no longer grew, or with its share of the decisions."""


class TrainingCard(_Record):
    """Where the weights come from."""

    command: Text
    seed: Count
    steps: Count
    """Joint decisions."""
    wall_time: Amount
    """s."""
    versions: dict[Text, Text]
    """Of the packages that computed it."""
    stages: tuple[StageCard, ...] = Field(default=(), max_length=2000)
    """Of a curriculum, in their order; empty where there was none."""


class Evaluation(_Record):
    """How a controller did, without exploration."""

    controller: Text
    arena: Text
    robots: int = Field(ge=1)
    episode_steps: int = Field(ge=1)
    seed: Count
    delivered: tuple[tuple[Count, ...], ...] = Field(min_length=1)
    """[episodes][robots] pellets that each robot delivered."""
    collisions: tuple[Count, ...]
    """[episodes] decisions in which robots touched another under way, summed over robots."""

    @property
    def episodes(self) -> int:
        return len(self.delivered)

    @property
    def totals(self) -> tuple[int, ...]:
        """Pellets delivered by the whole team in each episode."""
        return tuple(sum(episode) for episode in self.delivered)

    @property
    def mean(self) -> float:
        """Pellets per episode, mean over episodes."""
        return sum(self.totals) / self.episodes

    @property
    def std(self) -> float:
        """Standard deviation of the pellets per episode (n - 1 in the denominator); 0 for one episode."""
        squares = sum((total - self.mean) ** 2 for total in self.totals)
        return float((squares / max(1, self.episodes - 1)) ** 0.5)

    @property
    def per_robot(self) -> tuple[float, ...]:
        """Pellets per episode that each robot delivered, mean over episodes."""
        return tuple(sum(robot) / self.episodes for robot in zip(*self.delivered, strict=True))

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        if any(len(episode) != self.robots for episode in self.delivered):
            raise ValueError(
                f"delivered must hold {self.robots} numbers, one for each robot, in each episode"
            )
        if len(self.collisions) != self.episodes:
            raise ValueError(f"collisions must hold {self.episodes} numbers, one for each episode")
        return self


class PolicyCard(_Record):
    """All that must be known to run a policy, and where it comes from."""

    format: Literal["robosim-policy"] = "robosim-policy"
    format_version: Literal[1] = 1
    robots: int = Field(ge=1, le=1000)
    technique: TechniqueCard
    arena: ArenaCard
    observation: ObservationCard
    actions: Literal["cardinal", "wheels"]
    num_actions: int = Field(ge=2, le=100)
    network: NetworkCard
    robot: RobotSection
    timing: TimingSection
    training: TrainingCard
    evaluation: Evaluation | None = None
    reference: Evaluation | None = None
    """Of the scripted controller `lanes`, over the same episodes."""
    notes: Text = ""
    """What the policy fails at, in a sentence or two."""

    @property
    def networks(self) -> int:
        """Networks in the file: one for each robot, or fewer where robots run equal ones."""
        return self.network.stored or self.robots

    @property
    def shared(self) -> bool:
        """Whether all robots run one network; it then drives a team of any size."""
        return self.network.stored == 1

    @property
    def share(self) -> float | None:
        """Pellets per episode relative to the reference's; None without both evaluations or if that is 0."""
        if self.evaluation is None or self.reference is None or self.reference.mean == 0.0:
            return None
        return self.evaluation.mean / self.reference.mean

    @model_validator(mode="after")
    def _check_team(self) -> Self:
        if self.network.of_robot and len(self.network.of_robot) != self.robots:
            raise ValueError(f"network.of_robot must hold {self.robots} numbers, one for each robot")
        if self.technique.action_mask and self.actions == "cardinal" and self.num_actions < NUM_ACTIONS:
            raise ValueError(f"num_actions must be {NUM_ACTIONS} for technique.action_mask")
        return self

    @property
    def layers(self) -> tuple[tuple[int, int], ...]:
        """(inputs, outputs) of each layer of a robot's network."""
        return tuple(pairwise((len(self.observation.names), *self.network.hidden, self.num_actions)))


def card_for(
    env: VectorEnv,
    weights: Mapping[str, NDArray[np.floating]],
    technique: TechniqueCard,
    training: TrainingCard,
) -> PolicyCard:
    """Return the card of a team that learned in `env`.

    `weights` are `layer0.weight` [networks, in, out], `layer0.bias` [networks, out] and so on: a network for
    each robot, or one that all robots run.
    """
    layers, networks = len(weights) // 2, len(weights["layer0.weight"])
    hidden = tuple(weights[f"layer{layer}.bias"].shape[1] for layer in range(layers - 1))
    shared = networks == 1 and (env.robots > 1 or technique.parameter_sharing)
    return PolicyCard(
        robots=env.robots if shared else networks,
        technique=technique,
        arena=arena_card(env.arena),
        observation=ObservationCard(
            encoding=env.layout.encoding,
            stigmergy=env.layout.stigmergy,
            names=env.layout.names,
            pheromone=PheromoneCard(**env.config.pheromone.model_dump()),
        ),
        actions=env.layout.actions,
        num_actions=env.num_actions,
        network=NetworkCard(hidden=hidden, of_robot=(0,) * env.robots if shared else ()),
        robot=RobotSection(**asdict(env.arena.robot)),
        timing=TimingSection(**asdict(env.arena.timing)),
        training=training,
    )


def arena_card(arena: Arena) -> ArenaCard:
    """Return what a card says of an arena."""
    fingerprint = hashlib.sha256(arena.text.encode("utf-8")).hexdigest()
    return ArenaCard(name=arena.name, sha256=fingerprint, cell_size=arena.cell_size)


def card_text(card: PolicyCard) -> str:
    """Return the card as the JSON text that `read_card` reads."""
    return card.model_dump_json(indent=2) + "\n"


def read_card(path: Path) -> PolicyCard:
    """Read and check a card; InputError in one sentence for whatever is wrong with it."""
    data = read_limited(path, _MOST_BYTES)
    try:
        version = json.loads(data).get("format_version")
    except (ValueError, RecursionError, AttributeError):
        raise InputError(f"{path}: not a policy card, which is a JSON object.") from None
    if type(version) is int and version != FORMAT_VERSION:
        raise InputError(f"{path}: format_version is {version}; this robosim reads version {FORMAT_VERSION}.")
    try:
        return PolicyCard.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        places = (str(path), ".".join(map(str, first["loc"])), _reason(first["msg"], first["input"]))
        raise InputError(f"{': '.join(filter(None, places))}.") from None


def read_limited(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file of at most `most` bytes; InputError otherwise."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a directory; a file is needed here.")
        if not path.exists():
            raise InputError(f"{path}: there is no such file.")
        if not path.is_file():
            raise InputError(f"{path}: not a regular file.")
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
    if len(data) > most:
        raise InputError(f"{path}: the file is larger than {most} bytes, the most it may have.")
    return data


def _reason(message: str, value: object) -> str:
    message = message.removeprefix("Value error, ")
    sentence = message[0].lower() + message[1:]
    return sentence if isinstance(value, dict) else f"{sentence}, not {str(value)[:60]!r}"
