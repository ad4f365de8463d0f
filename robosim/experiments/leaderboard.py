"""The leaderboard: by arena and team size, what systems deliver, as records say it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

import robosim
from robosim.control.card import MOST, PolicyCard
from robosim.control.controller import SCRIPTED
from robosim.errors import InputError, whole_number
from robosim.experiments.comparison import REFERENCE
from robosim.experiments.runs import PELLETS, Run, Task, read_runs, require_same_tasks, shipped_run
from robosim.experiments.statistics import LEAST_RUNS, Estimate, estimate, interquartile_mean, mean
from robosim.experiments.team import POLICY
from robosim.files import real_path
from robosim.robot.drivers import ACTION_KINDS

Kind = Literal["trained", "scripted", "one team"]
NOT_RANKED = {"tuning.results.jsonl", "time.results.jsonl"}
"""Records of the search for settings: what it chose by its seed must not be judged by it again. And of runs
that were made to be timed, some of which other records hold, too, from another machine."""
OURS = "robosim"
"""Where entries come from that robosim has itself."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A system in a task."""

    task: Task
    rank: int | None
    """Among the ranked entries of the task, from 1; None for one team, which was chosen among several."""
    system: str
    """Technique, with the options that tell it from others of it in the task, or the name of a team."""
    kind: Kind
    """Trained with several seeds; a script, which does not learn; or one finished team."""
    source: str
    """`robosim`, or the name of the file or folder that the entry was read from; its path where names are
    alike."""
    seeds: int
    """Of its trainings; of a script, of its evaluations."""
    episodes: int
    """Of all seeds together."""
    steps: int | None
    """Joint decisions that a training took; None where it is not known, and for scripts."""
    pellets: Estimate
    """In an episode: the interquartile mean over seeds of each seed's mean, with the interval for other
    seeds; of one team the mean over its episodes, with the interval for other episodes."""
    share: float | None
    """Of what `lanes` delivers in the same task; None where that is not known."""


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """All entries, the best first within each task, and sentences on what was left out."""

    entries: Sequence[Entry]
    notes: Sequence[str]

    def by_task(self) -> Iterator[tuple[Task, list[Entry]]]:
        """Yield each task with its entries."""
        for task in dict.fromkeys(entry.task for entry in self.entries):
            yield task, [entry for entry in self.entries if entry.task == task]

    def as_record(self) -> dict[str, Any]:
        """Return everything as tables and lists, for a JSON file."""
        return asdict(self)


def committed_records() -> list[Path]:
    """Return the files of results that robosim keeps with its code, but for those that are not ranked.

    None beside an installed package.
    """
    folder = Path(robosim.__file__).parent.parent / "docs" / "results"
    return sorted(path for path in folder.glob("*.results.jsonl") if path.name not in NOT_RANKED)


def leaderboard(
    records: Iterable[Path], policies: Mapping[str, PolicyCard], others: Iterable[Path] = ()
) -> Leaderboard:
    """Return the leaderboard of robosim's own records and policies, and of those of others.

    A path is what `read_runs` takes. A training is ranked from `LEAST_RUNS` seeds on. With fewer, robosim's
    own are left out, and those of others stand beside without a rank. InputError as of `read_runs`, and where
    an arena of one name has two texts.
    """
    own = read_runs(records)
    shipped = {name: run for name, card in policies.items() if (run := shipped_run(name, card))}
    # A file that is given twice, by whatever path, counts once.
    given = list({real_path(path): path for path in map(Path, others)}.values())
    sources = {OURS: own, **{name: read_runs([path]) for name, path in _named_paths(given).items()}}
    require_same_tasks([*shipped.values(), *(run for runs in sources.values() for run in runs)])
    entries, few = [], 0
    for source, runs in sources.items():
        whole = [
            group
            for group in _systems(runs)
            if source != OURS or len(group) >= LEAST_RUNS or group[0].technique.startswith(POLICY)
        ]
        few += len(runs) - sum(map(len, whole)) if source == OURS else 0
        entries += [_entry(system, group, source) for system, group in _named(whole)]
    entries += [replace(_entry(run.technique, [run], OURS), kind="one team") for run in shipped.values()]
    notes = (
        [f"{few} runs are left out: of their systems there are fewer than {LEAST_RUNS} seeds."] if few else []
    )
    return Leaderboard(_ranked(entries, _reference(policies, shipped)), notes)


def _named_paths(paths: Sequence[Path]) -> dict[str, Path]:
    """Return paths by their names, with the folders before those that another one has, or robosim itself."""
    names = [OURS, *(path.name for path in paths)]
    return {
        path.name if names.count(path.name) == 1 else f"{path.parent}/{path.name}": path for path in paths
    }


def _systems(runs: Sequence[Run]) -> list[list[Run]]:
    """Return the runs of each system in each task."""
    groups: dict[tuple[Task, str], list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.task, run.system].append(run)
    return list(groups.values())


def _named(systems: Sequence[list[Run]]) -> Iterator[tuple[str, list[Run]]]:
    """Yield the systems with names: the technique, and as few options as tell those of a task apart.

    Actions other than cardinal ones are named wherever they are: such teams are of another kind.
    """
    alike: dict[tuple[Task, str], list[list[Run]]] = defaultdict(list)
    for system in systems:
        alike[system[0].task, system[0].technique].append(system)
    for (_, technique), group in alike.items():
        full = [dict(_options_of(system[0])) for system in group]
        needed: list[str] = []
        told = 1
        for option in dict.fromkeys(name for options in full for name in options):
            now = len({tuple(options.get(name) for name in (*needed, option)) for options in full})
            if now > told:
                needed, told = [*needed, option], now
        for options, system in zip(full, group, strict=True):
            actions = str(system[0].options.get("actions", ACTION_KINDS[0]))
            apart = {"actions": actions} if actions != ACTION_KINDS[0] and "actions" not in needed else {}
            named = apart | {name: options[name] for name in needed if name in options}
            shown = [f"{name}={value}" for name, value in named.items()]
            yield " ".join([technique, *shown]), system


def _options_of(run: Run) -> Iterator[tuple[str, str]]:
    """Yield the options behind the technique in the name of a run's system."""
    for part in run.system.removeprefix(run.technique).split():
        name, _, value = part.partition("=")
        yield name, value


def _entry(system: str, runs: Sequence[Run], source: str) -> Entry:
    for run in runs:
        if not run.figures.get(PELLETS):
            raise InputError(f"{run.source}: figures must hold {PELLETS}, a number for each episode.")
    first, scores = runs[0], [score for run in runs if (score := run.score(PELLETS)) is not None]
    per_episode = np.array([pellets for run in runs for pellets in run.figures[PELLETS]], dtype=np.float64)
    scripted = first.technique in SCRIPTED
    # A finished team may have been evaluated several times: its seeds are those of episodes.
    finished = first.technique.startswith(POLICY)
    alone = finished or len(runs) == 1
    kind: Kind = "scripted" if scripted else "one team" if alone else "trained"
    steps = first.options.get("steps")
    return Entry(
        task=first.task,
        rank=0 if not finished and (scripted or len(runs) >= LEAST_RUNS) else None,
        system=system.removeprefix(POLICY),
        kind=kind,
        source=source,
        seeds=1 if finished else len(runs),
        episodes=sum(len(run.figures[PELLETS]) for run in runs),
        steps=None if scripted or steps is None else whole_number(f"{first.source}: steps", steps, 0, MOST),
        pellets=estimate(mean, per_episode) if alone else estimate(interquartile_mean, np.array(scores)),
        share=None,
    )


def _reference(policies: Mapping[str, PolicyCard], shipped: Mapping[str, Run]) -> dict[Task, float]:
    """Return what `lanes` delivers by the cards of policies, where records do not say it."""
    known = {}
    for name, run in shipped.items():
        reference = policies[name].reference
        if reference is not None and reference.controller == REFERENCE:
            known[run.task] = reference.mean
    return known


def _ranked(entries: Sequence[Entry], lanes: Mapping[Task, float]) -> list[Entry]:
    """Return the entries with ranks and shares, the best first within each task."""
    ordered = sorted(entries, key=lambda one: (one.task, -one.pellets.value))
    # Those of our own records count before those on cards, and these before those of others.
    measured = [one for one in ordered if one.system == REFERENCE]
    own = {one.task: one.pellets.value for one in measured if one.source == OURS}
    of_lanes = {one.task: one.pellets.value for one in reversed(measured)} | dict(lanes) | own
    found, places = [], dict.fromkeys((one.task for one in ordered), 0)
    for one in ordered:
        if one.rank is not None:
            places[one.task] += 1
        scale = of_lanes.get(one.task, 0.0)
        found.append(
            replace(
                one,
                rank=None if one.rank is None else places[one.task],
                share=one.pellets.value / scale if scale > 0.0 else None,
            )
        )
    return found
