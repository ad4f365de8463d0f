"""Runs that are compared: read from run folders, files of results and evaluations into one kind of record."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.arena import load_arena
from robosim.control.card import MOST_BYTES, Evaluation, PolicyCard
from robosim.control.controller import SCRIPTED
from robosim.control.network import DRAWING
from robosim.control.policy import RUN_CONFIG, RUN_RECORD, check_run
from robosim.envs.config import MOST_CONFIG, MOST_STEPS, EnvConfig
from robosim.envs.profile import CHANGED, ProfileConfig, load_profile
from robosim.equality import EqualByValue
from robosim.errors import InputError, printable, shown, whole_number, without_controls
from robosim.experiments.jobs import CONFIG_FILE as JOB_FILE
from robosim.experiments.jobs import WORK_FOLDER
from robosim.experiments.results import Result, read_results
from robosim.experiments.team import POLICY
from robosim.texts import parse_json, parse_toml, read_limited, read_toml

Floats = NDArray[np.float64]

PELLETS = "pellets"
"""The figure that is compared where none is asked for: pellets that the team delivered in each episode."""
TOUCHES = "touches"
"""Decisions in which robots that did not stop touched another, summed over robots, in each episode."""

# As `robosim.learning.folder` names them, which takes torch to load.
EVALUATION_FILE = "evaluation.json"
METRICS_FILE = "metrics.parquet"

_GROUPS = ("env", "variety", "algorithm", "schedule")
"""Tables of a run's configuration on which depends what is learned."""
_NAMES: Mapping[str, Mapping[tuple[str, ...], str]] = {
    "env": {option.path: name for name, option in EnvConfig.options().items()},
    "algorithm": {("name",): "algorithm"},
}
"""Short names of options by their paths in a table, where they are not the path itself."""
_LONGEST_VALUE = 40
"""Characters of an option's value in the name of a system."""
_WEIGHTS = ("weights", "start_weights")
"""What a record says of a policy that is measured, and of one that a run starts from."""
_OF_TASK = {"world", "arena", "robots"}
_UNNAMED = "a profile without a name"


@dataclass(frozen=True, slots=True, order=True)
class Task:
    """What a run was evaluated in: runs of one task differ in their systems and seeds alone."""

    arena: str
    """Its name."""
    world: str
    episode_steps: int
    """Decisions in an episode."""
    robots: int
    profile: str = ""
    """Under which it was evaluated, by its name; empty for none."""

    def __str__(self) -> str:
        grid = " (grid world)" if self.world == "grid" else ""
        robots = f"{self.robots} robot" + ("s" if self.robots > 1 else "")
        under = f", under {self.profile}" if self.profile else ""
        return f"{self.arena}{grid}, {robots}, episodes of {self.episode_steps} decisions{under}"


@dataclass(frozen=True, slots=True, eq=False)
class Curve(EqualByValue):
    """How a run learned, exploration included: all arrays are [points]."""

    steps: Floats
    """Joint decisions, summed over environments."""
    pellets: Floats
    """Delivered in 1000 decisions of an environment, up to each point since the one before."""

    def between(self, edges: Floats) -> Floats:
        """Return pellets in 1000 decisions of each stretch between `edges` [n + 1], joint decisions: [n]."""
        steps = np.concatenate([[0.0], self.steps])
        delivered = np.concatenate([[0.0], np.cumsum(self.pellets * np.diff(steps))])
        return np.asarray(np.diff(np.interp(edges, steps, delivered)) / np.diff(edges))


@dataclass(frozen=True, slots=True)
class Run:
    """One training, or one evaluation of a controller that does not learn, with one seed."""

    source: str
    """Where it was read, for sentences about it."""
    technique: str
    """Or name of the controller."""
    task: Task
    seed: int
    figures: Mapping[str, Sequence[float]]
    """By name, one number for each episode of the evaluation."""
    delivered: Sequence[Sequence[float]] = ()
    """[episodes][robots] pellets that each robot delivered; empty where it is not known."""
    by_then: Sequence[float] = ()
    """[points] pellets delivered in the first episode by points at equal distances; empty where not known."""
    curve: Curve | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    """By short name, what the system may differ in from others of its technique."""
    map: str = ""
    """The arena's text; empty where it is not known."""
    profile: str = ""
    """What the task's profile says, as JSON."""
    learned_under: str = ""
    """What the profile says under which it was trained, as JSON; empty for none, and where options say it."""
    machine: Mapping[str, str] = field(default_factory=dict)
    """Where it ran; empty where it is not known."""
    team: str = ""
    """Which, of a team that has learned before and is evaluated by itself; empty for other runs. The seed is
    that of its training, and of its evaluation where that is not known."""
    episodes_seed: int | None = None
    """Of the evaluation of such a team."""
    system: str = ""
    """Technique, and behind it the options in which it differs from others of it: see `name_systems`."""

    def score(self, metric: str) -> float | None:
        """Return the mean of a figure over the episodes; None where the run has none of that name."""
        values = self.figures.get(metric)
        return float(np.mean(values)) if values else None


def read_runs(paths: Iterable[str | Path]) -> list[Run]:
    """Read all runs that `paths` hold, in order of task, system and seed.

    A path is a run folder, a folder with run folders below it, a file of results, or a file that
    `robosim evaluate --json` wrote. A run that is found twice counts once, by its longer evaluation if the
    shorter one is the beginning of it, and the evaluations of one trained team are one run: further episodes
    are no repetition of its training. Beside the run itself they do not count. InputError for a path without
    runs, a run without an evaluation, two different runs of one system, task and seed, and two arenas, or two
    profiles, of one name.
    """
    runs = name_systems([run for path in paths for run in _runs_in(Path(path))])
    require_same_tasks(runs)
    _require_same("profiles", runs, lambda run: (str(run.options.get("profile")), run.learned_under))
    found: dict[tuple[str, Task, int, int | None], Run] = {}
    for run in runs:
        known = run.system, run.task, run.seed, run.episodes_seed
        found[known] = _longer(found[known], run) if known in found else run
    return sorted(_pooled(found.values()), key=lambda run: (run.task, run.system, run.seed))


def _longer(one: Run, other: Run) -> Run:
    """Return the evaluation of more episodes; InputError unless those of the other are the first of them."""
    first, second = (_counted(run) for run in (one, other))
    both = min(map(len, (first[PELLETS], second[PELLETS])))
    same = all(first[name][:both] == second[name][:both] for name in first.keys() & second.keys())
    if not same or (not both and first != second):
        raise InputError(
            f"{one.source} and {other.source} are both {one.system} with seed {one.seed} in {one.task}, "
            "but with other results: give one of them."
        )
    return other if len(second[PELLETS]) > len(first[PELLETS]) else one


def _counted(run: Run) -> dict[str, list[Any]]:
    """Return what is counted in every episode, as far as it is known."""
    counted = {name: list(run.figures[name]) for name in (PELLETS, TOUCHES) if name in run.figures}
    by_robot = {"delivered": list(map(tuple, run.delivered))} if run.delivered else {}
    return {PELLETS: [], **counted, **by_robot}


def _pooled(runs: Iterable[Run]) -> Iterator[Run]:
    """Yield the runs, those of one team in one task as one run with the episodes of all."""
    teams: dict[tuple[str, Task, str], list[Run]] = defaultdict(list)
    whole = set()
    for run in runs:
        if run.team:
            teams[run.system, run.task, run.team].append(run)
        else:
            whole.add((run.system, run.task, run.seed))
            yield run
    for evaluations in teams.values():
        every = sorted(evaluations, key=lambda run: run.episodes_seed or 0)
        if (every[0].system, every[0].task, every[0].seed) in whole:
            continue
        first = every[0]
        known = [name for name in first.figures if all(name in run.figures for run in every)]
        figures = {name: tuple(one for run in every for one in run.figures[name]) for name in known}
        # Of episodes that only some of the evaluations know, nothing is known of the whole.
        delivered = [one for run in every for one in run.delivered] if all(r.delivered for r in every) else []
        yield replace(first, figures=figures, delivered=tuple(delivered))


def shipped_run(name: str, card: PolicyCard) -> Run | None:
    """Return the evaluation of a policy that ships as a run; None where its card has none."""
    if card.evaluation is None:
        return None
    seed, text = card.training.seed, card.env.arena
    run = _evaluated(card.evaluation, f"policies/{name}", technique=name, seed=seed, map=text, system=name)
    return replace(run, options={"steps": card.training.steps})


def require_same_tasks(runs: Sequence[Run]) -> None:
    """Raise InputError where two different arenas, or two profiles, go by one name."""
    _require_same("arenas", runs, lambda run: (run.task.arena, run.map))
    _require_same("profiles", runs, lambda run: (run.task.profile, run.profile))


def name_systems(runs: Sequence[Run]) -> list[Run]:
    """Return the runs with the names of their systems.

    A system is a technique; where runs of it differ in options within a task, it is the technique and these
    options. What differs from task to task alone, as the length of training may, makes no other system.
    """
    groups: dict[tuple[str, Task], list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.technique, run.task].append(run)
    differing: dict[str, dict[str, None]] = defaultdict(dict)
    for (technique, _), group in groups.items():
        for name in dict.fromkeys(name for run in group for name in run.options):
            # An evaluation by itself says little of the options: what is not known is not different.
            values = [value for run in group if (value := _option(run, name)) is not None]
            if any(value != values[0] for value in values):
                differing[technique][name] = None
    return [replace(run, system=_system(run, differing[run.technique])) for run in runs]


def _require_same(what: str, runs: Sequence[Run], named: Callable[[Run], tuple[str, str]]) -> None:
    """Raise InputError where a name is that of two texts; `named` returns a run's name and text."""
    known: dict[str, Run] = {}
    for run in runs:
        name, text = named(run)
        if text and named(known.setdefault(name, run))[1] != text:
            raise InputError(
                f"{known[name].source} and {run.source} have two different {what} named "
                f"{shown(name)}: they cannot be compared."
            )


def _option(run: Run, name: str) -> Any:
    """Return the value of an option; "none" where a whole configuration lacks it, None where it is not known.

    What is none, a charge that there is not, for instance, is not written into configurations.
    """
    return run.options.get(name, "none" if "algorithm" in run.options else None)


def _system(run: Run, differing: Iterable[str]) -> str:
    values = {name: _option(run, name) for name in differing}
    options = [f"{name}={_written(value)}" for name, value in values.items() if value is not None]
    # It becomes a row, a key and a label, and may be a stranger's.
    return without_controls(" ".join([run.technique, *options]))


def _written(value: Any) -> str:
    """Return an option's value in few characters, without spaces and commas, and other for other values."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        text = "x".join(map(_written, value))
    else:
        text = value if isinstance(value, str) else shown(value)
    if len(text) > _LONGEST_VALUE:
        told_by = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:6]
        text = f"{text[: _LONGEST_VALUE - 7]}~{told_by}"
    return text.replace(",", ";").replace(" ", "-")


def _runs_in(path: Path) -> list[Run]:
    if path.is_dir():
        return _runs_below(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such run folder, results file or evaluation.")
    if evaluations := read_evaluations(path):
        return [_evaluated(one, str(path), **_team_of(one, str(path))) for one in evaluations]
    results = read_results(path)
    if not results:
        raise InputError(f"{path}: there is no result in this file.")
    return [_read_result(result, f"{path} ({result.key[:16]})") for result in results.values()]


def _team_of(evaluation: Evaluation, source: str) -> dict[str, Any]:
    """Return what an evaluation by itself says of its team: which run trained it, or its name alone."""
    name, seed = evaluation.controller, evaluation.seed
    if name in SCRIPTED:
        return {"technique": name, "seed": seed}
    if evaluation.trained is None:
        return {"technique": name, "seed": seed, "team": name, "episodes_seed": seed}
    place = f"{source}: trained"
    fields = _described(parse_toml(evaluation.trained, place), place)
    return {**fields, "team": f"seed {fields['seed']}", "episodes_seed": seed}


def _runs_below(path: Path) -> list[Run]:
    folders = [path] if (path / RUN_CONFIG).exists() else [file.parent for file in path.rglob(RUN_CONFIG)]
    if not folders:
        raise InputError(f"{path}: there is no run in this folder: no {RUN_CONFIG} in it or below it.")
    own = [folder for folder in sorted(folders) if not _is_of_sweep(folder)]
    if not own:
        raise InputError(f"{path}: the runs in this folder are those of a sweep: give its file of results.")
    return [_read_folder(folder) for folder in own]


def _is_of_sweep(folder: Path) -> bool:
    """Return whether a run is a part of a sweep's job, whose evaluation is in the sweep's results alone."""
    work = folder.absolute().parent
    return work.name == WORK_FOLDER and (work.parent / JOB_FILE).exists()


def _read_folder(folder: Path) -> Run:
    """Return the run in a run folder; InputError where it is damaged or has no evaluation."""
    path = folder / EVALUATION_FILE
    if not path.exists():
        goes_on = f"`robosim train --resume {folder}` goes on with it"
        without = f"it was trained without; `robosim evaluate {folder} --json FILE` makes one"
        why = without if (folder / RUN_RECORD).exists() else goes_on
        raise InputError(f"{folder}: this run has no evaluation ({EVALUATION_FILE}): {why}.")
    check_run(folder)
    evaluations = read_evaluations(path)
    if len(evaluations) != 1:
        raise InputError(f"{path}: this is not the evaluation of a run.")
    (evaluation,) = evaluations
    config = folder / RUN_CONFIG
    tables = read_toml(config, MOST_CONFIG, "run configuration")
    arena = load_arena(str(_table(tables, "env", str(config)).get("arena", evaluation.arena)))
    described = _described(tables, str(config))
    curve = _read_curve(folder / METRICS_FILE)
    return _evaluated(evaluation, str(folder), curve=curve, map=arena.text, **described)


def read_evaluations(path: Path) -> list[Evaluation]:
    """Return the evaluations in a file that `robosim evaluate --json` wrote, of one team or of several.

    Empty where it is no such file, but may hold results. InputError for one that is not whole.
    """
    try:
        found = parse_json(read_limited(path, MOST_BYTES, "file of evaluations or results"))
    except ValueError:
        return []
    if isinstance(found, dict) and "controller" in found:
        return [Evaluation.from_table(found, str(path))]
    if isinstance(found, list) and all(isinstance(one, dict) and "evaluation" in one for one in found):
        return [Evaluation.from_table(one["evaluation"], str(path)) for one in found]
    return []


def _read_curve(path: Path) -> Curve | None:
    """Return the learning curve in a file of metrics; None where there is no file, or no row in it."""
    if not path.exists():
        return None
    from pyarrow import ArrowException

    from robosim.learning.metrics import read_metrics

    try:
        rows = read_metrics(path)
    except InputError:
        raise
    except (ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        reason = printable(str(error), 200)
        raise InputError(f"{path}: cannot be read as the metrics of a run ({reason}).") from None
    if not rows:
        return None
    pellets = [1000.0 * row.delivered / row.decisions for row in rows]
    return Curve(np.array([float(row.step) for row in rows]), np.array(pellets))


def _evaluated(evaluation: Evaluation, source: str, **fields: Any) -> Run:
    figures = {
        PELLETS: tuple(map(float, evaluation.totals)),
        TOUCHES: tuple(map(float, evaluation.collisions)),
    }
    profile, text = _effective(evaluation.profile)
    arena = without_controls(evaluation.arena)
    task = Task(arena, evaluation.world, evaluation.episode_steps, evaluation.robots, profile)
    return Run(
        source=source, task=task, figures=figures, delivered=evaluation.delivered, profile=text, **fields
    )


def _read_result(result: Result, source: str) -> Run:
    """Return the run that a line of a sweep's results is of."""
    env = EnvConfig.from_table(_table(result.config, "env", source), f"{source}: env")
    measuring = _table(result.config, "evaluation", source)
    try:
        arena = load_arena(env.arena)
    except InputError as error:
        raise InputError(f"{source}: env.arena: {error}") from None
    steps = whole_number(
        f"{source}: evaluation.steps", measuring.get("steps") or arena.timing.episode_steps, 1, MOST_STEPS
    )
    given = measuring.get("profile")
    profile, text = _effective(None if given is None else load_profile(str(given)))
    series, curve = result.series, None
    if series.get("learned"):
        if len(series["learned"]) != len(series.get("learned_pellets", ())):
            raise InputError(f"{source}: learned_pellets must have a number for each of learned.")
        if not (np.diff(series["learned"], prepend=0.0) > 0.0).all():
            raise InputError(f"{source}: learned must hold numbers above 0 that grow.")
        curve = Curve(np.array(series["learned"]), np.array(series["learned_pellets"]))
    pellets = np.array(series.get("robot_pellets", ()))
    if pellets.size % env.robots:
        raise InputError(f"{source}: robot_pellets must have a number for each of {env.robots} robots.")
    pellets = pellets.reshape(-1, env.robots)
    fields = _described(result.config, source)
    if "algorithm" not in result.config:
        # What a controller that is only measured does not learn from makes no other controller of it.
        fields["options"] = {"actions": env.actions, "keep_distance": env.keep_distance or "none"}
        if fields["technique"].startswith(POLICY):
            # It has learned before: seeds here are those of its evaluations.
            fields |= {"team": fields["technique"], "episodes_seed": fields["seed"]}
    fields["options"] |= {name: str(result.config[name]) for name in _WEIGHTS if name in result.config}
    return Run(
        source=source,
        task=Task(arena.name, env.world, steps, env.robots, profile),
        figures=result.figures,
        delivered=tuple(map(tuple, pellets)),
        by_then=series.get("pellets_by_then", ()),
        curve=curve,
        map=arena.text,
        profile=text,
        machine=result.machine,
        **fields,
    )


def _effective(profile: ProfileConfig | None) -> tuple[str, str]:
    """Return the name of a profile and what it says, as JSON; nothing where it changes nothing."""
    if profile is None:
        return "", ""
    bare = profile.changed(name="", description="")
    if bare == ProfileConfig():
        return "", ""
    return without_controls(profile.name) or _UNNAMED, bare.model_dump_json()


def _described(config: Mapping[str, Any], place: str) -> dict[str, Any]:
    """Return technique, seed and options of a run by its configuration, whatever version wrote it."""
    run = _table(config, "run", place)
    technique, seed = run.get("technique"), run.get("seed")
    if not isinstance(technique, str) or isinstance(seed, bool) or not isinstance(seed, int):
        raise InputError(f"{place}: run.technique and run.seed must be there, a text and a whole number.")
    # Said by all runs, or one without would not be told from those with one.
    options: dict[str, Any] = {}
    if "algorithm" in config:
        options |= {name: run.get(name) or "none" for name in DRAWING}
    learned_under = ""
    for group in _GROUPS:
        if group in config:
            table = _table(config, group, place)
            if group == "env":
                profile, learned_under, changed = _learned_under(table.get("profile"), place)
                # As above: said by all runs.
                table = {**table, "profile": changed}
                options |= {"profile": profile} if "algorithm" in config else {}
                options |= _trained_in(table, place) if "algorithm" in config else {}
            names = _NAMES.get(group, {})
            options |= {names.get(path, ".".join(path)): value for path, value in _leaves(table)}
    options = {name: value for name, value in options.items() if name not in _OF_TASK}
    return {
        "technique": technique or str(options.get("algorithm")),
        "seed": seed,
        "options": options,
        "learned_under": learned_under,
    }


def _trained_in(env: Mapping[str, Any], place: str) -> dict[str, str]:
    """Return the option that tells a team which learned elsewhere from one that learned in its task."""
    try:
        arena = load_arena(str(env.get("arena"))).name
    except InputError as error:
        raise InputError(f"{place}: env.arena: {error}") from None
    return {"trained_in": f"{arena}{'-grid' * (env.get('world') == 'grid')}-{env.get('robots')}"}


def _learned_under(given: object, place: str) -> tuple[str, str, dict[str, Any]]:
    """Return name and text of the profile in a configuration, and the fields that tell it from others.

    A name says all, and then there are no such fields; but not where there is none, or where options have
    changed the profile, and then the text is empty.
    """
    if not isinstance(given, Mapping):
        return "none", "", {}
    profile = ProfileConfig.from_table(given, f"{place}: env.profile")
    name, text = _effective(profile)
    if not text or (profile.name and not profile.name.endswith(CHANGED)):
        return name or "none", text, {}
    return name, "", {key: value for key, value in given.items() if key not in ("name", "description")}


def _leaves(table: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*above, name))
        else:
            yield (*above, name), value


def _table(config: Mapping[str, Any], name: str, place: str) -> dict[str, Any]:
    value = config.get(name)
    if not isinstance(value, Mapping):
        raise InputError(f"{place}: {name} is {shown(value)}, but must be a table.")
    return dict(value)
