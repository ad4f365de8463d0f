"""`robosim compare`: what runs say about their systems, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from robosim.cli.tables import aligned, digits_for, written
from robosim.errors import InputError, without_controls

if TYPE_CHECKING:
    from robosim.experiments.comparison import Comparison, Overall, Table
    from robosim.experiments.runs import Run


@dataclass(frozen=True)
class Compare:
    """Compare runs: interquartile means, probability of improvement, profiles, with 95 % intervals."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN...")]
    """Run folders, folders with run folders below them, results of sweeps, files of `evaluate --json`."""
    metric: str = "pellets"
    """Figure that is compared, by its mean over a run's episodes."""
    baseline: str | None = None
    """System that the others are measured by; by default `lanes`, or the best where it has no runs."""
    figures: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """New folder to write figures to, as PNG and SVG."""
    json: Path | None = None
    """File to write all numbers to."""
    marl_eval: Path | None = None
    """File to write what marl-eval reads."""

    def run(self) -> None:
        """Compare, print a table for each task, and write what was asked for."""
        import json

        from robosim.experiments.comparison import compare
        from robosim.experiments.marl_eval import marl_eval_tables
        from robosim.experiments.runs import read_runs
        from robosim.files import require_apart, require_writable, write_whole

        if not self.runs:
            raise InputError("compare needs runs: give run folders, results of sweeps or evaluations.")
        outputs = {"--json": self.json, "--marl-eval": self.marl_eval}
        require_apart(outputs, self.runs, self.figures)
        for path in outputs.values():
            if path is not None:
                require_writable(path)
        if self.figures is not None:
            self._require_figures(self.figures)
        runs = read_runs(self.runs)
        comparison = compare(runs, self.metric, self.baseline)
        tables, notes = marl_eval_tables(runs, self.metric) if self.marl_eval else ({}, [])
        print("\n".join(lines_of(comparison)), flush=True)
        for note in notes:
            print(without_controls(note))
        if self.json is not None:
            write_whole(self.json, json.dumps(comparison.as_record(), indent=2, allow_nan=False) + "\n")
            print(f"written: {self.json}")
        if self.marl_eval is not None:
            write_whole(self.marl_eval, json.dumps(tables, allow_nan=False) + "\n")
            print(f"written: {self.marl_eval}")
        if self.figures is not None:
            self._write_figures(self.figures, comparison, runs)

    def _require_figures(self, folder: Path) -> None:
        """Find out before long work whether figures can be drawn, and written there."""
        import importlib

        importlib.import_module("robosim.experiments.compare_figures")
        from robosim.analysis.report.folder import require_folder

        require_folder(folder)

    def _write_figures(self, folder: Path, comparison: Comparison, runs: Sequence[Run]) -> None:
        from robosim.analysis.report.folder import whole_folder
        from robosim.experiments.compare_figures import draw_comparison

        with whole_folder(folder) as part:
            for name, figure in draw_comparison(comparison, runs):
                (part / f"{name}.png").write_bytes(figure.png)
                (part / f"{name}.svg").write_bytes(figure.svg)
            names = sorted(path.stem for path in part.glob("*.png"))
        print(f"written: {folder} ({', '.join(names)})")


def lines_of(comparison: Comparison) -> list[str]:
    """Return the comparison as lines of text: a table for each task, one over all, and notes."""
    lines: list[str] = []
    for table in comparison.tables:
        lines += [f"{table.task}: {comparison.metric} per episode", *_task_lines(table), ""]
    if comparison.overall:
        count = sum(table.scale > 0.0 for table in comparison.tables)
        lines += [f"all {count} tasks, as shares of the baseline", *_overall_lines(comparison.overall), ""]
    lines = [*lines, *comparison.notes] if comparison.notes else lines[:-1]
    return list(map(without_controls, lines))


def _task_lines(table: Table) -> list[str]:
    of = table.baseline
    head = ["system", "seeds", "episodes", "IQM, 95 % interval"]
    if table.scale > 0.0:
        head.append(f"share of {of}")
    if of is not None:
        head.append(f"better than {of}")
    rows = [head]
    digits = digits_for([row.iqm.value for row in table.rows])
    for row in table.rows:
        cells = [row.system, str(len(row.seeds)), str(row.episodes), written(row.iqm, digits)]
        if row.iqm.low is None and len(row.scores) > 1:
            cells[3] += f" ({', '.join(f'{score:.{digits}f}' for score in row.scores)})"
        if table.scale > 0.0:
            cells.append(written(row.normalised, 2))
        if of is not None:
            cells.append(written(row.improvement, 2))
        rows.append(cells)
    return aligned(rows)


def _overall_lines(systems: Sequence[Overall]) -> list[str]:
    rows = [["system", "IQM, 95 % interval", "median", "mean", "optimality gap", "better than it"]]
    for one in systems:
        estimates = (one.iqm, one.median, one.mean, one.optimality_gap, one.improvement)
        rows.append([one.system, *(written(estimate, 2) for estimate in estimates)])
    return aligned(rows)
