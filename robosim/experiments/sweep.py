"""A sweep: which runs a file asks for, read strictly, and the job of each."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, Field, ValidationError, model_validator

from robosim.arena import arena_names, load_arena
from robosim.control.controller import SCRIPTED
from robosim.control.network import DRAWING
from robosim.envs.config import EnvConfig
from robosim.envs.profile import profile_text
from robosim.errors import InputError, nearest_names, refused, shown
from robosim.experiments.jobs import Job
from robosim.experiments.options import OptionCheck
from robosim.experiments.team import (
    POLICY,
    Measuring,
    env_of_policy,
    learning_job,
    measuring_job,
    require_driving,
    require_learning,
)
from robosim.learning.config import (
    DEFAULT_TECHNIQUE,
    TRAINING_ENV,
    RunConfig,
    RunSettings,
    run_config,
    self_contained,
)
from robosim.learning.idle import idle_options
from robosim.learning.technique import TECHNIQUES, find_technique
from robosim.records import Many, Record, sentence
from robosim.texts import parse_toml, read_toml
from robosim.world.factory import WorldKind, room_in

MOST_RUNS = 10_000
_MOST_VALUES = 1000
_MOST_BYTES = 1_000_000
_TECHNIQUE = "technique"
_SEED = "seed"
_SCALAR = "a number, a text, true or false"
_VALUE = f"{_SCALAR}, or a list of them"
_QUOTED = """"[^"]*"|'[^']*'"""
_PART = re.compile(
    rf"""\s*(?P<name>[^=,]+?)\s*=\s*(?P<value>\[(?:{_QUOTED}|[^\]"'])*\]|{_QUOTED}|[^,]*?)\s*(?:,|$)"""
)
"""Of `--only`: commas within a list or a text part nothing."""


class _Table(BaseModel):
    """A table of the file; no `Record`, since one of its keys is `options`."""

    model_config = Record.model_config


class Where(_Table):
    """What other runs than the rest take, or that they are not run."""

    match: dict[str, Any] = Field(max_length=100)
    """A value, or a list of values, for each name: runs that have one of them in all of these names match;
    without any name, all do."""
    options: dict[str, Any] = Field(default={}, max_length=200)
    """What they take as well."""
    trials: Many[dict[str, Any]] = Field(default=(), max_length=_MOST_VALUES)
    """One run for each of these tables of options, in the place of the one."""
    skip: str = Field(default="", max_length=500)
    """Why they are not run."""

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.skip and (self.options or self.trials):
            raise ValueError(
                "skip says that these runs are not run, so there must be neither options nor trials"
            )
        if not (self.skip or self.options or self.trials):
            raise ValueError("there must be options, trials or skip")
        return self


class SweepFile(_Table):
    """What a file of a sweep may hold."""

    about: str = Field(default="", max_length=2000)
    """What the sweep is for, in a sentence."""
    options: dict[str, Any] = Field(default={}, max_length=200)
    """Options of every run, by the names of `run_config`."""
    vary: dict[str, Any] = Field(default={}, max_length=50)
    """Lists of values: every combination of them is a run, and the last varies fastest."""
    where: Many[Where] = Field(default=(), max_length=_MOST_VALUES)
    """In their order, so that later ones win."""
    evaluation: Measuring = Measuring()
    """How every team is measured."""


@dataclass(frozen=True)
class Run:
    """One run of a sweep."""

    names: Mapping[str, Any]
    """What tells it from the others: its values of [vary], and of its trial."""
    options: Mapping[str, Any]
    """All that the file says of it, technique and seed too."""
    job: Job | None
    """None for a run that is skipped."""
    skip: str = ""
    """Why it is skipped."""

    @property
    def label(self) -> str:
        """Its names and values in one line; the technique where nothing varies."""
        return _label(self.names or {_TECHNIQUE: self.options[_TECHNIQUE]})


@dataclass(frozen=True)
class Sweep:
    """The runs that a file asks for, in its order, each once."""

    about: str
    runs: Sequence[Run]

    @property
    def jobs(self) -> list[Job]:
        """The jobs of those that are not skipped."""
        return [run.job for run in self.runs if run.job is not None]

    def only(self, text: str) -> Sweep:
        """Return the runs with certain values: `technique=smadrl,robots=4,robots=8`.

        Values are written as in the sweep's file, texts also without quotes; those of the same name are
        alternatives. InputError for a name or a value that no run has, and where no run is left.
        """
        wanted: dict[str, list[Any]] = {}
        for name, value in _named_values(text):
            had = [run.options[name] for run in self.runs if name in run.options]
            if not had:
                names = {name for run in self.runs for name in run.options}
                raise InputError(f"--only: {shown(name)} is in no run: {nearest_names(name, names)}")
            found = [one for one in _meant(value) if _among(one, had)]
            if not found:
                near = nearest_names(value, {_plain(one) for one in had})
                raise InputError(f"--only: no run has {name} {shown(value)}: {near}")
            wanted.setdefault(name, []).extend(found)
        kept = [
            run
            for run in self.runs
            if all(
                name in run.options and _among(run.options[name], values) for name, values in wanted.items()
            )
        ]
        if not kept:
            raise InputError(
                f"--only is {shown(text)}: every one of these values has runs, but none has all."
            )
        return replace(self, runs=kept)


def read_sweep(path: Path) -> Sweep:
    """Read the file of a sweep; InputError in one sentence for its first mistake.

    An arena's file is looked for from the working directory, as on the command line, and its text becomes
    part of the runs.
    """
    place = str(path)
    file = _checked(read_toml(path, _MOST_BYTES, "sweep file"), place)
    if file.evaluation.profile is not None:
        try:
            profile_text(file.evaluation.profile)
        except InputError as error:
            raise InputError(f"{place}: evaluation.profile: {error}") from None
    for name, values in file.vary.items():
        if not isinstance(values, list) or not 1 <= len(values) <= _MOST_VALUES:
            raise refused(f"{place}: vary.{name}", values, f"a list of 1 to {_MOST_VALUES} values")
    for where, table in _tables(file):
        for name, value in table.items():
            _check_value(f"{place}: {where}.{name}", name, value)
    for name, values in file.vary.items():
        if repeated := [value for number, value in enumerate(values) if _among(value, values[:number])]:
            raise InputError(f"{place}: vary.{name} has {shown(repeated[0])} twice.")
    for number, block in enumerate(file.where, 1):
        for trial in _repeated(block.trials):
            raise InputError(
                f"{place}: where {number}: trials has {_label(trial) or 'an empty table'} twice."
            )
    drafts = _combinations(file, place)
    for number, block in enumerate(file.where, 1):
        drafts = _after(drafts, block, f"{place}: where {number}")
    return Sweep(file.about, _built(drafts, file.evaluation, place))


def _checked(table: Mapping[str, Any], place: str) -> SweepFile:
    """Return what a file holds; InputError for the first mistake, with the number of its [[where]]."""
    try:
        return SweepFile.model_validate(table)
    except ValidationError as error:
        match error.errors()[0]["loc"]:
            case ("where", int(number), *_):
                block = table["where"][number]
            case _:
                raise InputError(f"{place}: {sentence(SweepFile, error)}") from None
    place = f"{place}: where {number + 1}"
    if not isinstance(block, Mapping):
        raise InputError(f"{place} is {shown(block)}, but must be a table.")
    try:
        Where.model_validate(block)
    except ValidationError as error:
        raise InputError(f"{place}: {sentence(Where, error)}") from None
    raise AssertionError("a block with a mistake has one by itself, too")


@dataclass(frozen=True)
class _Draft:
    """A run before its options are checked."""

    names: Mapping[str, Any]
    options: Mapping[str, Any]
    skip: str = ""


def _tables(file: SweepFile) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield all tables of options, and those of [vary], one for each combination of places in its lists."""
    yield "options", file.options
    for name, values in file.vary.items():
        for value in values:
            yield "vary", {name: value}
    for number, block in enumerate(file.where, 1):
        yield f"where {number}: options", block.options
        for trial in block.trials:
            yield f"where {number}: trials", trial


def _check_value(place: str, name: str, value: object) -> None:
    """Raise InputError for what is no value of an option, or for an option that the sweep decides on."""
    parts = value if isinstance(value, list) else [value]
    if not all(isinstance(part, bool | int | float | str) for part in parts):
        raise refused(place, value, _VALUE)
    if name.startswith("evaluation_"):
        raise InputError(f"{place} cannot be given: [evaluation] says how teams are measured.")
    if name in RunSettings.model_fields and name not in (_TECHNIQUE, _SEED, *DRAWING):
        raise InputError(f"{place} cannot be given: a sweep runs each team in one process of its own.")


def _combinations(file: SweepFile, place: str) -> list[_Draft]:
    count = math.prod(len(values) for values in file.vary.values())
    _check_count(count, f"{place}: vary")
    base = {_TECHNIQUE: DEFAULT_TECHNIQUE, _SEED: 0, **file.options}
    drafts = []
    for values in itertools.product(*file.vary.values()):
        names = dict(zip(file.vary, values, strict=True))
        drafts.append(_Draft(names, base | names))
    return drafts


def _check_count(count: int, place: str) -> None:
    if count > MOST_RUNS:
        raise InputError(f"{place}: these are {count} runs, but there must be at most {MOST_RUNS}.")


def _after(drafts: Sequence[_Draft], block: Where, place: str) -> list[_Draft]:
    """Return the runs as a block leaves them; InputError for one that no run matches."""
    wanted = {name: value if isinstance(value, list) else [value] for name, value in block.match.items()}
    for name, values in wanted.items():
        had = [draft.options[name] for draft in drafts if name in draft.options]
        if not had:
            names = {name for draft in drafts for name in draft.options}
            raise InputError(f"{place}: match.{name} is in no run: {nearest_names(name, names)}")
        for value in values:
            if not _among(value, had):
                near = nearest_names(_plain(value), {_plain(one) for one in had})
                raise InputError(f"{place}: match.{name} is {shown(value)} in no run: {near}")
    matching = [
        all(name in draft.options and _among(draft.options[name], values) for name, values in wanted.items())
        for draft in drafts
    ]
    if not any(matching):
        raise InputError(f"{place}: no run matches.")
    _check_count(len(drafts) + sum(matching) * max(0, len(block.trials) - 1), place)
    pairs = zip(drafts, matching, strict=True)
    return [after for draft, matches in pairs for after in (_changed(draft, block) if matches else [draft])]


def _changed(draft: _Draft, block: Where) -> Iterable[_Draft]:
    if block.skip:
        return [replace(draft, skip=block.skip)]
    after = []
    for trial in block.trials or ({},):
        options = {**draft.options, **block.options, **trial}
        after.append(
            replace(draft, names={name: options[name] for name in {**draft.names, **trial}}, options=options)
        )
    return after


def _built(drafts: Sequence[_Draft], measuring: Measuring, place: str) -> list[Run]:
    """Return each run once, with its job; InputError for a technique, an option or a value that cannot be."""
    builder = _Builder(measuring)
    runs: list[Run] = []
    seen: set[str] = set()
    doing: dict[str, tuple[_Draft, Mapping[str, str]]] = {}
    for draft in drafts:
        if draft.skip:
            runs.append(Run(draft.names, draft.options, None, draft.skip))
            continue
        try:
            job, config = builder.job(draft.options)
        except InputError as error:
            raise InputError(f"{place}: {_label(draft.names) or 'options'}: {error}") from None
        if job.key in seen:
            continue
        seen.add(job.key)
        idle = {} if config is None else _idle_in(config, draft.options)
        effective = {name: value for name, value in draft.options.items() if name not in idle}
        does = builder.job(effective)[0].key if idle else job.key
        if does in doing:
            other, idle_there = doing[does]
            raise InputError(f"{place}: {_twice(draft, other, {**idle_there, **idle})}")
        doing[does] = draft, idle
        runs.append(Run(draft.names, draft.options, job))
    return runs


def _idle_in(config: RunConfig, options: Mapping[str, Any]) -> dict[str, str]:
    """Return those options of a training that change nothing in it, and why."""
    return {
        one.name: f"without {one.needs}" if one.needs else f"there ({one.why})"
        for one in idle_options(config, options)
    }


def _twice(draft: _Draft, other: _Draft, idle: Mapping[str, str]) -> str:
    """Return the sentence about a run that differs from another one only in what changes nothing."""
    name = next(name for name in idle if draft.options.get(name) != other.options.get(name))
    one, before = (_label(run.names or {_TECHNIQUE: run.options[_TECHNIQUE]}) for run in (draft, other))
    return (
        f"{one}: this is {before} once more, since {name} changes nothing {idle[name]}: "
        "give it with [[where]] to the runs that it is for."
    )


class _Builder:
    """Makes the job of a run out of its options."""

    def __init__(self, measuring: Measuring) -> None:
        self._measuring = measuring
        self._arenas: dict[str, str] = {}
        self._rooms: dict[tuple[WorldKind, str, float | None], tuple[str, int]] = {}
        self._tried: set[tuple[str, ...]] = set()
        self._check = OptionCheck()

    def job(self, options: Mapping[str, Any]) -> tuple[Job, RunConfig | None]:
        """Return the job, and the training in it if a team learns.

        InputError for a technique, an option or a value that cannot be.
        """
        if isinstance(options.get("arena"), str):
            options = {**options, "arena": self._whole_arena(options["arena"])}
        team = options[_TECHNIQUE]
        if not isinstance(team, str):
            raise refused(_TECHNIQUE, team, "a text")
        if team in SCRIPTED or team.startswith(POLICY):
            return self._measured(team, options), None
        _require_technique(team)
        config = self_contained(run_config(**options))
        if config.variety is None:
            self._require_room(config.env)
        job = learning_job(config, self._measuring)
        self._require_sound(config)
        return job, config

    def _require_sound(self, config: RunConfig) -> None:
        """Raise InputError for a run that would fail in its turn; runs that are alike are tried once."""
        schedule, device = config.schedule, getattr(config.algorithm, "device", None)
        what = [config.env.model_dump_json(), str(device)]
        if config.variety is not None:
            what += [config.variety.model_dump_json(), str(schedule.num_envs)]
        if schedule.start_from:
            what += [config.algorithm.model_dump_json(), schedule.changed(steps=1).model_dump_json()]
        if self._is_new(*what):
            require_learning(config, self._measuring)

    def _is_new(self, *what: str) -> bool:
        """Return whether nothing alike has been tried before."""
        new = what not in self._tried
        self._tried.add(what)
        return new

    def _measured(self, team: str, options: Mapping[str, Any]) -> Job:
        """Return the job that only measures: it takes the options of the environment, and the seed."""
        self._check.require({name: value for name, value in options.items() if name != _TECHNIQUE})
        of_env = EnvConfig.options()
        seed = RunSettings(seed=options[_SEED]).seed
        if team.startswith(POLICY):
            env = env_of_policy(team, options)
        else:
            env = TRAINING_ENV.with_options(**{n: value for n, value in options.items() if n in of_env})
        self._require_room(env)
        job = measuring_job(team, env, seed, self._measuring)
        if self._is_new(env.model_dump_json(), team):
            require_driving(team, env, self._measuring)
        return job

    def _require_room(self, env: EnvConfig) -> None:
        """Raise InputError for more robots than the arena has room for: now, and not in the run's turn."""
        where = env.world, env.arena, env.keep_distance
        if where not in self._rooms:
            arena = load_arena(env.arena)
            self._rooms[where] = arena.name, room_in(env.world, arena, env.keep_distance)
        name, room = self._rooms[where]
        if env.robots > room:
            allowed = f"a whole number from 1 to {room}, the room in arena {name!r}"
            raise refused("robots", env.robots, allowed)

    def _whole_arena(self, arena: str) -> str:
        """Return an arena's name where it ships, and its text else."""
        if arena not in self._arenas:
            self._arenas[arena] = arena if arena in arena_names() else load_arena(arena).text
        return self._arenas[arena]


def _require_technique(name: str) -> None:
    """Raise InputError for what is neither a technique nor a scripted controller."""
    try:
        find_technique(name)
    except InputError:
        near = nearest_names(name, {*TECHNIQUES, *SCRIPTED})
        raise InputError(f"unknown technique {shown(name)}: {near}") from None


def _named_values(text: str) -> Iterator[tuple[str, str]]:
    """Yield the names and values of `--only`; InputError where there are none."""
    place = 0
    while place < len(text) or not place:
        part = _PART.match(text, place)
        if part is None:
            raise InputError(f"--only is {shown(text)}, but must be NAME=VALUE, or several with commas.")
        yield part["name"], part["value"]
        place = part.end()


def _meant(value: str) -> list[Any]:
    """Return what may be meant by a value of `--only`: itself, and what it says in a file."""
    try:
        return [value, *parse_toml(f"value = {value}", "--only").values()]
    except InputError:
        return [value]


def _among(value: object, others: Iterable[object]) -> bool:
    """Return whether a value is one of the others; true is no number."""
    return any(_same(value, other) for other in others)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and one == other


def _repeated(tables: Sequence[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Yield each table that is equal to one before it."""
    for number, table in enumerate(tables):
        for before in tables[:number]:
            if table.keys() == before.keys() and all(_same(table[name], before[name]) for name in table):
                yield table
                break


def _plain(value: object) -> str:
    return value if isinstance(value, str) else shown(value)


def _label(names: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={_plain(value)}" for name, value in names.items())
