"""A policy's card: what it was trained on and how, and what its observations and actions mean."""

from __future__ import annotations

import hashlib
import json
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robosim.arena.model import Arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.errors import InputError

FORMAT_VERSION = 1
"""Raised when a card's meaning changes; a reader refuses the versions that it does not know."""

_MOST_BYTES = 1_000_000

Text = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0.0)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class TechniqueCard(_Record):
    """How the policy learned."""

    name: Text
    global_reward: bool
    stigmergy: bool
    curriculum: bool


class ArenaCard(_Record):
    """Where the policy learned."""

    name: Text
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    """Fingerprint of the arena file's text."""
    cell_size: float = Field(gt=0.0)
    """m."""


class ObservationCard(_Record):
    """What a robot's observation holds, in order."""

    encoding: Literal["paper", "expanded"]
    stigmergy: bool
    names: tuple[Text, ...] = Field(min_length=1, max_length=100_000)


class NetworkCard(_Record):
    """Shape of each robot's network: ReLU after every layer but the last."""

    hidden: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field(min_length=1, max_length=8)


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

    @property
    def layers(self) -> tuple[tuple[int, int], ...]:
        """(inputs, outputs) of each layer of a robot's network."""
        return tuple(pairwise((len(self.observation.names), *self.network.hidden, self.num_actions)))


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
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {place}: {_reason(first['msg'], first['input'])}.") from None


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
    sentence = message[0].lower() + message[1:]
    return sentence if isinstance(value, dict) else f"{sentence}, not {str(value)[:60]!r}"
