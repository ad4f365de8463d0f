"""A report of an evaluation: a folder with a page, figures, tables and the episodes, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from robosim.analysis.figures.catalogue import FIGURES, draw
from robosim.analysis.measure.metrics import summarise
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.report.clip import longest_clog
from robosim.analysis.report.folder import LAST_FILE, whole_folder
from robosim.analysis.report.page import page
from robosim.analysis.report.tables import clog_table, flow_table, metrics_record, trip_table, visit_table
from robosim.control.card import Evaluation
from robosim.episodes.trajectory import LONGEST_POLICY, Trajectory
from robosim.errors import InputError, without_controls


@dataclass(frozen=True, slots=True)
class Watched:
    """An evaluation, and what was seen of it."""

    evaluation: Evaluation
    episodes: Sequence[Episode]
    trajectories: Sequence[Trajectory]
    command: str
    """What a person types to make the same report."""


def write_report(folder: Path, watched: Watched) -> Path:
    """Write the report and return its page; `folder` is new or empty.

    InputError, in one sentence, if it cannot be written; nothing is left behind then.
    """
    episodes = watched.episodes
    summaries = summarise(episodes)
    figures = {plot.name: draw(plot, episodes) for plot in FIGURES}
    record = metrics_record(watched.evaluation, episodes, summaries, watched.command)
    clip = longest_clog(episodes, watched.trajectories)
    text = page(watched.evaluation, episodes, summaries, figures, watched.command, clip)
    with whole_folder(folder) as part:
        (part / "figures").mkdir()
        for name, files in figures.items():
            (part / "figures" / f"{name}.png").write_bytes(files.png)
            (part / "figures" / f"{name}.svg").write_bytes(files.svg)
        (part / "metrics.json").write_text(
            json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        _write_table(trip_table(episodes), part / "trips.parquet")
        _write_table(clog_table(episodes), part / "clogs.parquet")
        _write_table(visit_table(episodes), part / "visits.parquet")
        _write_table(flow_table(episodes), part / "flow.parquet")
        (part / "episodes").mkdir()
        for number, trajectory in enumerate(watched.trajectories):
            named = replace(
                trajectory,
                policy=trajectory.policy or without_controls(watched.evaluation.controller)[:LONGEST_POLICY],
            )
            file = f"episodes/{number}.npz"
            try:
                named.save(part / file)
            except InputError as error:
                # It names the hidden folder, which nobody knows.
                raise InputError(str(error).replace(str(part / file), str(folder / file))) from None
        (part / LAST_FILE).write_text(text, encoding="utf-8")
    return folder / LAST_FILE


def _write_table(table: pa.Table, path: Path) -> None:
    # Through memory, since pyarrow's own errors for files are many lines long.
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer)
    path.write_bytes(buffer.getvalue())
