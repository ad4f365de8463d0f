"""The figures of a run as it goes on, and the Parquet file that keeps them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from robosim.errors import InputError
from robosim.files import is_regular, whole_file

_MOST_BYTES = 300_000_000
"""Of the metrics of a run, unpacked."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Figures of the joint decisions since the row before."""

    step: int
    """Joint decisions so far, summed over environments."""
    decisions: int
    """Joint decisions in this row."""
    episode: int
    """Episodes finished so far in the stage."""
    stage: str
    """Name of the curriculum's stage; "together" without a curriculum."""
    stage_step: int
    """Joint decisions so far in the stage."""
    robots: int
    """In the tunnel."""
    learning: int
    """How many of them learn."""
    reward: float
    """Unscaled reward per decision and learning robot."""
    delivered: int
    """Pellets delivered by all robots in all environments."""
    collisions: float
    """Robots that touched another one while under way, per joint decision."""
    blocked: float
    """Share of the robots that were in mode Collision: under way, in touch with something, standing still."""
    steps_per_second: float
    """Joint decisions per second of wall time."""
    figures: Mapping[str, float]
    """The algorithm's own, by name, as its latest update returned them."""

    def as_record(self) -> dict[str, Any]:
        """Return all fields, and the algorithm's figures beside them, by name."""
        fixed = {name: getattr(self, name) for name in FIXED}
        return fixed | dict(self.figures)


FIXED = tuple(field.name for field in fields(Metrics) if field.name != "figures")
"""Names of the columns that every algorithm has."""


@dataclass(slots=True)
class Sums:
    """What has been added up since the row before, and what goes on beyond it."""

    step: int = 0
    stage_step: int = 0
    episodes: int = 0
    reward: float = 0.0
    decisions: int = 0
    delivered: int = 0
    delivered_before: int = 0
    collisions: int = 0
    blocked: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)


class MetricsLog:
    """Adds up what happens in a run and cuts it into rows."""

    def __init__(self) -> None:
        self.rows: list[Metrics] = []
        self.sums = Sums()
        self._since = time.perf_counter()

    def begin_stage(self) -> None:
        """Count episodes and decisions of the stage anew."""
        self.sums.stage_step = self.sums.episodes = self.sums.delivered_before = 0
        self.sums.figures = {}

    def note(self, figures: Mapping[str, float]) -> None:
        """Take in the figures of an update; those of the latest stand in the row.

        ValueError for a name that a column of its own has.
        """
        if figures:
            if not figures.keys().isdisjoint(FIXED):
                raise ValueError(
                    f"an algorithm's figures must not be named {sorted(figures.keys() & set(FIXED))}"
                )
            self.sums.figures = {name: float(value) for name, value in figures.items()}

    def add(
        self,
        reward: NDArray[np.float32],
        delivered: NDArray[np.int64],
        ended: NDArray[np.bool_],
        collided: NDArray[np.bool_],
        blocked: NDArray[np.bool_],
        decisions: int | None = None,
    ) -> None:
        """Take in one decision of every environment.

        `reward` is [envs, learning robots], `delivered` (in the episode so far), `collided` and `blocked` are
        [envs, robots], `ended` [envs]. `decisions` is how many environments there are in truth, where robots
        of one stand in several rows; all end together then.
        """
        sums, totals = self.sums, delivered.sum(axis=1)
        decisions = len(reward) if decisions is None else decisions
        sums.step += decisions
        sums.stage_step += decisions
        sums.decisions += decisions
        sums.reward += float(reward.sum()) / (reward.size / decisions)
        sums.delivered += int(totals.sum()) - sums.delivered_before
        # What ended episodes delivered is not subtracted again: the next ones start at nothing.
        sums.delivered_before = int(totals[~ended].sum())
        sums.episodes += int(ended.sum()) * decisions // len(ended)
        sums.collisions += int(np.count_nonzero(collided))
        sums.blocked += np.count_nonzero(blocked) / (blocked.size / decisions)

    def cut(self, stage: str, robots: int, learning: int) -> Metrics:
        """Close the row and return it."""
        now, sums = time.perf_counter(), self.sums
        row = Metrics(
            step=sums.step,
            decisions=sums.decisions,
            episode=sums.episodes,
            stage=stage,
            stage_step=sums.stage_step,
            robots=robots,
            learning=learning,
            reward=sums.reward / sums.decisions,
            delivered=sums.delivered,
            collisions=sums.collisions / sums.decisions,
            blocked=sums.blocked / sums.decisions,
            steps_per_second=sums.decisions / max(now - self._since, 1e-9),
            figures=dict(sums.figures),
        )
        self.rows.append(row)
        sums.reward = sums.blocked = 0.0
        sums.decisions = sums.delivered = sums.collisions = 0
        self._since = now
        return row


def write_metrics(rows: Sequence[Metrics], path: Path) -> None:
    """Write one Parquet row per entry: a column per field, and one per figure of the algorithm."""
    types = {"int": pa.int64(), "float": pa.float64(), "str": pa.string()}
    kinds = {one.name: types[str(one.type)] for one in fields(Metrics) if one.name in FIXED}
    kinds |= {name: pa.float64() for row in rows for name in row.figures}
    records = [row.as_record() for row in rows]
    columns = {name: [record.get(name) for record in records] for name in kinds}
    with whole_file(path) as part:
        pq.write_table(pa.table(columns, schema=pa.schema(list(kinds.items()))), part)


def read_metrics(path: Path) -> list[Metrics]:
    """Read back what `write_metrics` wrote; a row has the figures that it had.

    InputError for a file that holds too much, TypeError for one that holds a run's figures by other names.
    """
    rows = []
    if not is_regular(path):
        raise InputError(f"{path}: not a regular file.")
    held = pq.read_metadata(path)
    unpacked = sum(held.row_group(group).total_byte_size for group in range(held.num_row_groups))
    if max(unpacked, 8 * held.num_rows * held.num_columns) > _MOST_BYTES:
        raise InputError(f"{path}: holds more than {_MOST_BYTES} bytes, too large for the metrics of a run.")
    for record in pq.read_table(path).to_pylist():
        fixed = {name: record.pop(name) for name in FIXED}
        rows.append(Metrics(**fixed, figures={n: value for n, value in record.items() if value is not None}))
    return rows
