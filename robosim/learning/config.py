"""The configuration of a training run, and the TOML file that keeps it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
import tomli_w
from pydantic import Field, SerializeAsAny, field_validator, model_validator

from robosim.arena import arena_names, load_arena
from robosim.control.network import check_drawing
from robosim.control.policy import policy_names
from robosim.envs.config import MOST_CONFIG, EnvConfig, with_profile
from robosim.envs.profile import LONGEST_PROFILE, profile_text
from robosim.envs.variety import VarietyConfig
from robosim.errors import InputError, nearest_names, shown
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.protocol import AlgorithmConfig
from robosim.learning.algorithms.registry import algorithm_names, find_algorithm
from robosim.learning.technique import find_technique
from robosim.records import Record
from robosim.texts import read_toml

DEFAULT_TECHNIQUE = "ps-dqn"
EVALUATION_SEED = 2
"""Child of the run's root seed; 0 and 1 serve the first stage, and later ones take two each."""
TRAINING_ENV = EnvConfig(robots=2, pellet_gradient=8.0, episode_steps=1250)
"""Short episodes that begin as long digging leaves the pellets, so that many moments of it are seen."""


class ScheduleConfig(Record):
    """How much is learned, and by whom at a time."""

    steps: int = Field(default=30_000, ge=1, le=10**10)
    """Joint decisions in total, summed over environments and over the stages of a curriculum."""
    num_envs: int = Field(default=8, ge=1, le=4096)
    """Environments that run side by side."""
    curriculum: bool = False
    """Newcomers join one at a time while the robots before them stay frozen; otherwise all learn together."""
    first_team: int = Field(default=2, ge=1, le=1000)
    """Curriculum: robots that learn together first."""
    first_share: float | None = Field(default=None, gt=0, le=0.99)
    """Curriculum: share of the decisions that they take; none for as much as a newcomer each."""
    newcomer: Literal["scratch", "copy"] = "scratch"
    """Curriculum: a newcomer starts from random weights, or from a copy of the robot before it."""
    fine_tune: float = Field(default=0.0, ge=0, le=0.99)
    """Curriculum: share of the decisions, at the end, in which the whole team learns."""
    steady_gain: float = Field(default=0.0, ge=0, le=10)
    """Curriculum: a stage ends early once a fifth of it gains less return than this share; 0 for never."""
    start_from: str = Field(default="", max_length=4096)
    """Policy by name or folder whose robots the run starts with; empty for none."""

    @model_validator(mode="after")
    def _check_first_share(self) -> Self:
        if self.first_share is None:
            return self
        if not self.curriculum or self.start_from:
            raise ValueError(
                f"first_share is {shown(self.first_share)}, but must be absent where no team learns first"
            )
        if self.first_share + self.fine_tune >= 1.0:
            raise ValueError(
                f"first_share is {shown(self.first_share)}, but must be less than {1.0 - self.fine_tune:g}, "
                "what fine_tune leaves"
            )
        return self


class RunSettings(Record):
    """How a run is carried out and what it leaves; of these, only the seed changes what is learned."""

    technique: str = Field(default="", max_length=200)
    """Name of the preset that the run was made from, for the record."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Root of all randomness of the run."""
    workers: int = Field(default=1, ge=1, le=1024)
    """Processes that the environments are shared out to; the result is the same."""
    overlap: bool = False
    """Act and learn at the same time, on two cores; the result is the same."""
    checkpoint_every: int = Field(default=10_000, ge=0, le=10**10)
    """Joint decisions between two checkpoints, to be resumed from; 0 for none but at an interrupt."""
    record_every: int = Field(default=0, ge=0, le=10**10)
    """Joint decisions between two playbacks of the team so far; 0 for none."""
    record_steps: int = Field(default=500, ge=1, le=10**9)
    """Decisions in each of them."""
    evaluation_episodes: int = Field(default=5, ge=0, le=4096)
    """Episodes without exploration after training; 0 for none."""
    evaluation_steps: int = Field(default=0, ge=0, le=10**8)
    """Decisions in each of them; 0 for as many as the arena says."""
    evaluation_profile: str | None = Field(default=None, max_length=LONGEST_PROFILE)
    """Profile of the evaluation after training and of playbacks, by name, path or text; none for robots as
    their data sheet says, whatever profile they learn under."""
    temperature: float | None = Field(default=None, ge=0.001, le=1000)
    """The team that the run leaves draws its actions, with the probabilities softmax(outputs / temperature);
    none for the action of the largest output, every time."""
    temperature_in_place: float | None = Field(default=None, ge=0.001, le=1000)
    """Instead of `temperature`, for robots that have stood for a while; none for the same at all times."""
    retreat_in_place: int | None = Field(default=None, ge=3, le=10_000)
    """Decisions for which robots that have stood for a while retreat once they begin to; none for no
    retreats."""
    retreat_with_pellet: int | None = Field(default=None, ge=1, le=10_000)
    """The same for robots with a pellet; none for a third of that."""

    @model_validator(mode="after")
    def _check_drawing(self) -> Self:
        check_drawing(self)
        return self


class RunConfig(Record):
    """Everything that a run depends on."""

    plain_options: ClassVar[bool] = True

    env: EnvConfig = TRAINING_ENV
    """What the team learns in."""
    algorithm: SerializeAsAny[AlgorithmConfig] = DqnConfig()
    """What learns, and how."""
    variety: VarietyConfig | None = None
    """Several arenas and team sizes to learn in, for one network that all robots run; none for those of `env`
    alone."""
    schedule: ScheduleConfig = ScheduleConfig()
    """How much is learned, and by whom at a time."""
    run: RunSettings = RunSettings()
    """How the run is carried out."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all on which depends what is learned."""
        learned = self.model_dump(mode="json", exclude={"run"}) | {"seed": self.run.seed}
        return hashlib.sha256(json.dumps(learned, sort_keys=True).encode()).hexdigest()

    @field_validator("algorithm", mode="before")
    @classmethod
    def _find_algorithm(cls, value: object) -> object:
        if not isinstance(value, Mapping):
            return value
        if "name" not in value:
            raise ValueError(f"name is missing; it must be {' or '.join(map(shown, algorithm_names()))}")
        return find_algorithm(str(value["name"]))(**value)

    @model_validator(mode="after")
    def _check_curriculum(self) -> Self:
        if self.schedule.curriculum and self.algorithm.shares_parameters:
            raise ValueError(
                "curriculum is true, but must be false where robots share a network: it cannot be frozen "
                "beside itself"
            )
        if self.variety is not None:
            self._check_variety(self.variety)
        if self.run.workers > self.schedule.num_envs:
            raise ValueError(
                f"workers is {self.run.workers}, but must be a whole number from 1 to num_envs, "
                f"{self.schedule.num_envs}"
            )
        return self

    def _check_variety(self, variety: VarietyConfig) -> None:
        if self.algorithm.needs_team:
            raise ValueError(
                f"algorithm is {shown(self.algorithm.name)}, which learns from the whole team at once, but "
                "must be one whose robots learn each by itself with arenas or random_arenas"
            )
        if not self.algorithm.shares_parameters or self.algorithm.shares_by_group:
            raise ValueError(
                'parameters must be "shared" with arenas or random_arenas: one network drives all'
            )
        if self.schedule.num_envs % variety.envs_per_arena:
            raise ValueError(
                f"num_envs is {self.schedule.num_envs}, but must be a multiple of envs_per_arena, "
                f"{variety.envs_per_arena}"
            )
        if self.run.workers > 1:
            raise ValueError(f"workers is {self.run.workers}, but must be 1 with arenas or random_arenas")


def run_config(technique: str = DEFAULT_TECHNIQUE, **options: Any) -> RunConfig:
    """Return the configuration of a run by a technique, with other values in the fields of these names.

    Names are those of the command line: `robots`, `steps`, `learning_rate`, `pheromone_decay` and so on;
    `profile` is a profile, or the name, path or text of one.
    InputError for a technique or an option that there is not, and for a wrong value.
    """
    preset = find_technique(technique)
    algorithm = find_algorithm(preset.algorithm)()
    options = with_profile(options)
    env = TRAINING_ENV.changed(profile=options.pop("profile", None))
    base = RunConfig(env=env, algorithm=algorithm, run=RunSettings(technique=technique))
    return base.with_options(**preset.options_with(options))


def child_seed(seed: int, child: int) -> int:
    """Return a number drawn from a child of a run's root seed."""
    return int(np.random.SeedSequence(seed, spawn_key=(child,)).generate_state(1)[0])


def self_contained(config: RunConfig) -> RunConfig:
    """Return a configuration that means the same from another folder, and once an arena's file is changed."""
    arena, start = config.env.arena, config.schedule.start_from
    if arena not in arena_names():
        config = config.with_options(arena=load_arena(arena).text)
    if config.variety is not None:
        config = config.changed(variety=config.variety.self_contained())
    if config.run.evaluation_profile is not None:
        config = config.with_options(evaluation_profile=profile_text(config.run.evaluation_profile))
    if start not in policy_names() and os.path.isdir(start):  # noqa: PTH112 - a name may be too long
        config = config.with_options(start_from=str(Path(start).absolute()))
    return config


def write_config(config: RunConfig, path: Path) -> None:
    """Write every field as TOML, in a table each for env, algorithm, schedule and run; it repeats the run."""
    tables = config.model_dump(mode="json", exclude_none=True)
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")


def read_config(path: Path) -> RunConfig:
    """Read a file that `write_config` wrote; a missing key takes its default, an unknown one is an error.

    InputError in one sentence for a file that cannot be read, is not TOML, or holds a wrong value.
    """
    tables = read_toml(path, MOST_CONFIG, "run configuration")
    for name, table in tables.items():
        if name not in RunConfig.model_fields:
            raise InputError(
                f"{path}: {shown(name)} is no table: {nearest_names(name, RunConfig.model_fields)}"
            )
        if not isinstance(table, dict):
            raise InputError(f"{path}: {name} is {shown(table)}, but must be a table.")
    tables.setdefault("algorithm", {}).setdefault("name", DqnConfig().name)
    tables["env"] = _over(TRAINING_ENV.model_dump(), tables.get("env", {}))
    return RunConfig.from_table(tables, str(path))


def _over(defaults: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with defaults where it holds nothing, in the tables of it too."""
    merged = {**defaults, **table}
    for name, value in defaults.items():
        if isinstance(value, dict) and isinstance(merged[name], dict):
            merged[name] = _over(value, merged[name])
    return merged
