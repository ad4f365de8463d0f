"""Tables of a sweep: a row for each system, a column for each place and team size, with what did not run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from robosim.errors import InputError, nearest_names, shown
from robosim.experiments.results import Result
from robosim.experiments.statistics import LEAST_RUNS, estimate, interquartile_mean, point
from robosim.experiments.sweep import Run, Sweep

_COLUMNS = ("arena", "world", "robots")
"""What a column may tell apart; all else but the seed tells rows apart."""
_SEED = "seed"

WALL_TIME = "wall_time"
"""Of a run as a whole: time spent learning, s. A table may show it as it shows figures."""

Column = tuple[tuple[str, object], ...]
"""Names and values, of those of `_COLUMNS` that differ within the sweep."""


@dataclass(slots=True)
class Cell:
    """The runs of one system in one place, which differ in their seeds."""

    planned: int = 0
    """Runs that the sweep asks for."""
    scores: list[float] = field(default_factory=list)
    """Of those that have a record, in the sweep's order: the mean of a figure over a run's episodes."""
    without: int = 0
    """Runs whose record lacks the figure: how evenly one robot works, for one."""
    skip: str = ""
    """Why they are not run, if they are not to be."""

    @property
    def iqm(self) -> float | None:
        """Interquartile mean of the scores; None without any."""
        return point(interquartile_mean, np.array(self.scores)) if self.scores else None

    def shown(self, digits: int = 0) -> str:
        """Return the interquartile mean with its 95 % interval, or plainly what there is instead."""
        if self.skip:
            return "none"
        run = len(self.scores) + self.without
        if not run:
            return "not run" if self.planned else ""
        notes = [f"{run} of {self.planned}"] if run < self.planned else []
        if self.scores and self.without:
            notes.append(f"no figure in {self.without}")
        missing = f" ({', '.join(notes)})" if notes else ""
        if not self.scores:
            return "no figure" + missing
        if len(self.scores) < LEAST_RUNS:
            return ", ".join(f"{score:.{digits}f}" for score in self.scores) + missing
        found = estimate(interquartile_mean, np.array(self.scores))
        return f"{found.value:.{digits}f} [{found.low:.{digits}f}, {found.high:.{digits}f}]{missing}"


@dataclass(frozen=True, slots=True)
class SweepTable:
    """What the records of a sweep say of one figure."""

    columns: Sequence[Column]
    rows: Mapping[str, Mapping[Column, Cell]]
    """By system: the technique, and behind it the options by which a sweep tells its systems apart."""

    def cell(self, system: str, **place: object) -> Cell:
        """Return the cell of a system whose column has these values; InputError when there is none."""
        if system not in self.rows:
            raise InputError(f"no system {shown(system)} in the sweep: {nearest_names(system, self.rows)}")
        for column, cell in self.rows[system].items():
            if dict(column) == place:
                return cell
        raise InputError(f"no column {shown(place)} in the sweep.")

    def lines(
        self, digits: int = 0, above: Mapping[str, Mapping[Column, str]] | None = None
    ) -> Iterator[str]:
        """Yield the table in Markdown; `above` has texts by column for a row above the one of a system."""
        yield "| | " + " | ".join(map(heading, self.columns)) + " |"
        yield "|---" * (1 + len(self.columns)) + "|"
        for system, cells in self.rows.items():
            if above and (texts := above.get(system)):
                yield _row(f"{system} in the paper", [texts.get(column, "") for column in self.columns])
            shown_cells = [cells[column].shown(digits) if column in cells else "" for column in self.columns]
            yield _row(system, shown_cells)

    def reasons(self) -> Iterator[str]:
        """Yield a sentence for each system of which runs are left out on purpose."""
        for system, cells in self.rows.items():
            left: dict[str, list[str]] = {}
            for column, cell in cells.items():
                if cell.skip:
                    left.setdefault(cell.skip, []).append(heading(column))
            for reason, places in left.items():
                yield f"{system}, {', '.join(places)}: {reason}."


def sweep_table(sweep: Sweep, results: Mapping[str, Result], figure: str = "pellets") -> SweepTable:
    """Return the table of a figure, or of `WALL_TIME`: every run of the sweep is in it, with a record or not.

    `results` are records by key, as `read_results` returns them. Rows and columns stand in the sweep's order.
    """
    columns = [name for name in _COLUMNS if len({str(run.options.get(name)) for run in sweep.runs}) > 1]
    if "robots" not in columns:
        columns.append("robots")
    rows: dict[str, dict[Column, Cell]] = {}
    for run in sweep.runs:
        column = tuple((name, run.options.get(name)) for name in columns)
        cell = rows.setdefault(system_of(run), {}).setdefault(column, Cell())
        cell.planned += 1
        if run.job is None:
            cell.skip = run.skip.rstrip(".")
        elif (result := results.get(run.job.key)) is not None:
            if values := figure_of(result, figure):
                cell.scores.append(float(np.mean(values)))
            else:
                cell.without += 1
    every = dict.fromkeys(column for cells in rows.values() for column in cells)
    return SweepTable(sorted(every, key=_order), rows)


def figure_of(result: Result, figure: str) -> Sequence[float]:
    """Return the numbers of a record that a table is of; empty where it has none."""
    if figure == WALL_TIME:
        return [result.wall_time] if result.wall_time else []
    return result.figures.get(figure, ())


def system_of(run: Run) -> str:
    """Return the technique of a run, and the options by which its sweep tells it from others of it."""
    technique = str(run.options["technique"])
    others = [
        f"`{name}` {shown(value)}"
        for name, value in run.names.items()
        if name not in (*_COLUMNS, _SEED, "technique")
    ]
    return ", ".join([f"`{technique}`", *others])


def _row(name: str, texts: Sequence[str]) -> str:
    return f"| {name} | {' | '.join(texts)} |"


def heading(column: Column) -> str:
    """Return what stands above a column: `paper, grid, 8 robots`."""
    return ", ".join(
        f"{value} robot{'s' if value != 1 else ''}" if name == "robots" else str(value)
        for name, value in column
    )


def _order(column: Column) -> tuple[tuple[bool, str, float], ...]:
    return tuple(
        (False, "", float(value)) if isinstance(value, int | float) else (True, str(value), 0.0)
        for _, value in column
    )
