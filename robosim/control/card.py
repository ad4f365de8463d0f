"""A policy's card: what it was trained on and how, and what its observations and actions mean."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from robosim.arena.model import Arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.control.html import evaluation_html
from robosim.control.network import NetworkSpec, Weights, check_weights, unmet_standing
from robosim.discretise.observation import Columns, MoveGains, find_columns
from robosim.envs.config import MOST_CONFIG, EnvConfig
from robosim.envs.profile import ProfileConfig
from robosim.errors import InputError, printable, shown
from robosim.records import Many, Record
from robosim.robot.team import Group, RoleName
from robosim.texts import parse_json, read_limited
from robosim.world.factory import WorldKind

if TYPE_CHECKING:
    from robosim.envs.mixed import MixedVectorEnv
    from robosim.envs.vector import VectorEnv
    from robosim.envs.workers import WorkerVectorEnv

FORMAT_VERSION: Final = 2
"""Raised when a card's meaning changes; a reader refuses the versions that it does not know."""
MOST_BYTES = 5_000_000
"""What a card's file may hold; an arena's text takes up to a million."""

MOST: Final = 10**15
"""Of what a card counts; larger numbers than a float holds to the digit are no counts."""

Text = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0, le=MOST)]


class TechniqueCard(Record):
    """How the policy learned, for the reader: no code asks for it."""

    name: str = Field(max_length=200)
    facts: dict[Text, Text] = Field(default={}, max_length=100)
    """What else is worth knowing: which algorithm, with which settings."""


class GroupCard(Record):
    """Robots of a team that are alike."""

    name: str = Field(max_length=60)
    role: RoleName
    """What part of the work they do."""
    count: int = Field(ge=1, le=100)
    """Robots that it gets whenever robots are dealt out to the groups in turn."""
    robot: RobotSection
    """Their data sheet."""


class ArenaCard(Record):
    """Where the policy learned; its text is in `env.arena`."""

    name: str = Field(max_length=200)
    sha256: str = Field(max_length=64)
    """Fingerprint of the arena's text."""
    cell_size: float = Field(gt=0)
    """m."""
    robot: RobotSection
    """The robots' data sheet."""
    groups: Many[GroupCard] | None = None
    """Of a mixed team, whose data sheets count in place of `robot`; none for a team of equals."""
    timing: TimingSection
    """In the world in which the policy learned."""


class StageCard(Record):
    """A part of the training in which the same robots learned."""

    name: str = Field(max_length=200)
    robots: int = Field(ge=1)
    """In the tunnel."""
    learning: int = Field(ge=0)
    """How many of them learned; the others were frozen."""
    steps: int = Field(ge=0)
    """Joint decisions."""
    ended: Literal["steady", "budget"]
    """Whether the stage ended because its return no longer grew, or with its share of the decisions."""


class TrainingCard(Record):
    """Where the weights come from."""

    command: str = Field(max_length=2000)
    seed: int = Field(ge=0)
    steps: int = Field(ge=0)
    """Joint decisions."""
    wall_time: float = Field(ge=0, le=MOST)
    """s."""
    versions: dict[Text, Text] = Field(max_length=100)
    """Of the packages that computed it."""
    stages: Many[StageCard] = Field(default=(), max_length=2000)
    """Of a curriculum, in their order; empty where there was none."""


class GroupResult(NamedTuple):
    """What the robots of a group did in an episode, mean over episodes."""

    name: str
    robots: int
    delivered: float
    """Pellets."""
    handed_over: float
    """Pellets."""

    def words(self) -> str:
        """Return the result in words, without the group's name."""
        robots = f"{self.robots} robot" + ("" if self.robots == 1 else "s")
        handed = f", {self.handed_over:.1f} handed over" if self.handed_over else ""
        return f"{robots}: {self.delivered:.1f} pellets brought home{handed}"


class Evaluation(Record):
    """How a controller did, without exploration."""

    controller: str = Field(max_length=2000)
    arena: str = Field(max_length=2000)
    """Name of the arena."""
    world: WorldKind = "physics"
    robots: int = Field(ge=1, le=1000)
    episode_steps: int = Field(ge=1)
    seed: int = Field(ge=0)
    delivered: Many[Many[Count]] = Field(min_length=1)
    """[episodes][robots] pellets that each robot delivered."""
    collisions: Many[Count]
    """[episodes] decisions in which robots that did not stop touched another, summed over robots."""
    profile: ProfileConfig | None = None
    """What was random and wrong about robots and what they perceived; none for nothing."""
    closest: Many[Annotated[float, Field(ge=0)]] | None = None
    """[episodes] the least distance between the centres of two robots, m; none for one robot."""
    longest_lapse: Many[Count] | None = None
    """[episodes] the longest time without a delivery, decisions: from one to the next, from the beginning to
    the first or from the last to the end; none where it was not measured."""
    groups: Many[Text] | None = None
    """[robots] name of the group of each in a mixed team; none for a team of equals."""
    handed_over: Many[Many[Count]] | None = None
    """[episodes][robots] pellets that each robot handed over; none in a team without such roles."""
    trained: str | None = Field(default=None, max_length=MOST_CONFIG)
    """Configuration of the run that trained the team, TOML; none for others, and inside that run's folder."""

    @property
    def episodes(self) -> int:
        """How many episodes there were."""
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

    @property
    def by_group(self) -> tuple[GroupResult, ...]:
        """What each group of a mixed team did, in the order of their first robots; empty without groups."""
        names = self.groups or ()
        nothing = ((0,) * self.robots,) * self.episodes
        return tuple(
            GroupResult(
                name,
                names.count(name),
                *(
                    sum(one[robot] for one in counts for robot in range(self.robots) if names[robot] == name)
                    / self.episodes
                    for counts in (self.delivered, self.handed_over or nothing)
                ),
            )
            for name in dict.fromkeys(names)
        )

    def _repr_html_(self) -> str:
        return evaluation_html(self)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        for what, counts in (("delivered", self.delivered), ("handed_over", self.handed_over or ())):
            if any(len(episode) != self.robots for episode in counts):
                raise ValueError(
                    f"{what} must hold {self.robots} numbers, one for each robot, in each episode"
                )
        if self.handed_over is not None and len(self.handed_over) != self.episodes:
            raise ValueError(f"handed_over must hold {self.episodes} lists, one for each episode")
        if self.groups is not None and len(self.groups) != self.robots:
            raise ValueError(f"groups must hold {self.robots} names, one for each robot")
        if len(self.collisions) != self.episodes:
            raise ValueError(f"collisions must hold {self.episodes} numbers, one for each episode")
        if self.closest is not None and len(self.closest) != self.episodes:
            raise ValueError(f"closest must hold {self.episodes} numbers, one for each episode")
        if self.longest_lapse is not None and len(self.longest_lapse) != self.episodes:
            raise ValueError(f"longest_lapse must hold {self.episodes} numbers, one for each episode")
        return self


class PolicyCard(Record):
    """All that must be known to run a policy, and where it comes from."""

    format: Literal["robosim-policy"] = "robosim-policy"
    format_version: Literal[2] = FORMAT_VERSION
    technique: TechniqueCard
    env: EnvConfig
    """The environment in which the policy learned, with the arena's text."""
    arena: ArenaCard
    observation: Many[Text] = Field(min_length=1, max_length=100_000)
    """What a robot's observation holds, in order."""
    network: NetworkSpec
    training: TrainingCard
    evaluation: Evaluation | None = None
    reference: Evaluation | None = None
    """Of the scripted controller `lanes`, over the same episodes."""
    weights_sha256: str = Field(default="", max_length=64)
    """SHA-256 of the file of weights; empty as long as they are in no file."""
    notes: str = Field(default="", max_length=2000)
    """What the policy fails at, in a sentence or two."""

    @property
    def robots(self) -> int:
        """Robots in the team that learned."""
        return self.env.robots

    @property
    def share(self) -> float | None:
        """Pellets per episode relative to the reference's; None without both evaluations or if that is 0."""
        if self.evaluation is None or self.reference is None or self.reference.mean == 0.0:
            return None
        return self.evaluation.mean / self.reference.mean

    @property
    def gains(self) -> MoveGains | None:
        """Where an observation holds the gains of moves, as `gain_columns` returns it."""
        return self.columns.gains

    @property
    def columns(self) -> Columns:
        """Where an observation holds what a policy goes by, besides its networks."""
        return find_columns(self.observation, self.env.actions)

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        network, robots = self.network, self.env.robots
        if network.robots != robots:
            raise ValueError(
                f"network.of_robot is {shown(network.of_robot)}, but must hold {robots} numbers, "
                "one for each robot"
            )
        if network.observation != len(self.observation):
            raise ValueError(
                f"network.inputs is {network.inputs}, but must be the {len(self.observation)} numbers of an "
                "observation" + (", times the robots" if network.input == "team" else "")
            )
        if network.mask and self.gains is None:
            raise ValueError(
                f"network.mask is {shown(True)}, but must be {shown(False)} where observations hold no gains "
                "of moves"
            )
        if (unmet := unmet_standing(network, self.columns)) is not None:
            raise ValueError(f"network.{unmet}")
        if "\n" not in self.env.arena:
            raise ValueError(f"env.arena is {shown(self.env.arena)}, but must be the text of an arena")
        if self.arena.sha256 != fingerprint(self.env.arena):
            raise ValueError(
                f"arena.sha256 is {shown(self.arena.sha256)}, but must be the fingerprint of env.arena, "
                f"{shown(fingerprint(self.env.arena))}"
            )
        return self


def card_for(
    env: VectorEnv | WorkerVectorEnv | MixedVectorEnv,
    spec: NetworkSpec,
    weights: Weights,
    technique: str,
    training: TrainingCard,
    facts: Mapping[str, str] | None = None,
) -> PolicyCard:
    """Return the card of a team that learned in `env`; InputError for what does not fit together.

    `spec.of_robot` says how many robots the team has: in a curriculum they may be fewer than those of `env`.
    `technique` is a name for the reader, `facts` what else there is to say of how the team learned. An extra
    reward becomes one of them: whoever runs the team need not have the function.
    """
    check_weights(spec, weights, "weights")
    said, reward = dict(facts or {}), env.config.reward
    if reward.extra is not None:
        said["extra_reward"] = shown(reward.extra)
    return PolicyCard(
        technique=TechniqueCard(name=technique, facts=said),
        env=env.config.changed(robots=spec.robots, reward=reward.changed(extra=None)),
        arena=arena_card(env.arena),
        observation=env.layout.names,
        network=spec,
        training=training,
    )


def arena_card(arena: Arena) -> ArenaCard:
    """Return what a card says of an arena, whose timing is that of the world that runs it."""
    return ArenaCard(
        name=arena.name,
        sha256=fingerprint(arena.text),
        cell_size=arena.cell_size,
        robot=RobotSection(**asdict(arena.robot)),
        groups=tuple(map(_group_card, arena.groups)) or None,
        timing=TimingSection(**asdict(arena.timing)),
    )


def _group_card(group: Group) -> GroupCard:
    sheet = RobotSection(**asdict(group.sheet))
    return GroupCard(name=group.name, role=group.role, count=group.count, robot=sheet)


def fingerprint(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def read_evaluation(path: Path) -> Evaluation:
    """Read and check a file that holds an evaluation; InputError in one sentence if it is none."""
    try:
        table = parse_json(read_limited(path, MOST_BYTES, "evaluation"))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: not an evaluation, which is a JSON object ({error}).") from None
    return Evaluation.from_table(table, str(path))


def card_text(card: PolicyCard) -> str:
    """Return the card as the JSON text that `read_card` reads."""
    return card.model_dump_json(indent=2) + "\n"


def read_card(path: Path) -> PolicyCard:
    """Read and check a card; InputError in one sentence for whatever is wrong with it."""
    data = read_limited(path, MOST_BYTES, "policy card")
    try:
        table = parse_json(data)
    except ValueError as error:
        said = printable(str(error), 200)
        raise InputError(f"{path}: not a policy card, which is a JSON object ({said}).") from None
    if not isinstance(table, dict):
        raise InputError(f"{path}: not a policy card, which is a JSON object.")
    version = table.get("format_version")
    if type(version) is int and version != FORMAT_VERSION:
        raise InputError(
            f"{path}: format_version is {shown(version)}; this robosim reads version {FORMAT_VERSION}."
        )
    return PolicyCard.from_table(table, str(path))
