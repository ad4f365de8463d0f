"""The figures of a run as it goes on, and the Parquet file that keeps them."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Metrics:
    """Figures of the joint decisions since the row before."""

    step: int
    """Joint decisions so far, summed over environments."""
    decisions: int
    """Joint decisions in this row."""
    episode: int
    """Episodes finished so far."""
    epsilon: float
    """Share of random actions at the end of the row."""
    loss: float
    """Mean squared error of the latest batch, in scaled rewards, mean over robots; NaN before learning."""
    reward: float
    """Unscaled reward per decision and robot."""
    delivered: int
    """Pellets delivered by all robots in all environments."""
    steps_per_second: float
    """Joint decisions per second of wall time."""


class MetricsLog:
    """Adds up what happens in a run and cuts it into rows."""

    def __init__(self) -> None:
        self.rows: list[Metrics] = []
        self._step = 0
        self._episodes = 0
        self._reward = 0.0
        self._decisions = 0
        self._delivered = 0
        self._delivered_before = 0
        self._since = time.perf_counter()

    def add(
        self, reward: NDArray[np.float32], delivered: NDArray[np.int64], ended: NDArray[np.bool_]
    ) -> None:
        """Take in one decision of every environment.

        `reward` and `delivered` (in the episode so far) are [envs, robots]; `ended` [envs].
        """
        totals = delivered.sum(axis=1)
        self._step += len(reward)
        self._decisions += len(reward)
        self._reward += float(reward.sum()) / reward.shape[1]
        self._delivered += int(totals.sum()) - self._delivered_before
        # What ended episodes delivered is not subtracted again: the next ones start at nothing.
        self._delivered_before = int(totals[~ended].sum())
        self._episodes += int(ended.sum())

    def cut(self, epsilon: float, loss: float) -> Metrics:
        """Close the row and return it."""
        now = time.perf_counter()
        row = Metrics(
            step=self._step,
            decisions=self._decisions,
            episode=self._episodes,
            epsilon=epsilon,
            loss=loss,
            reward=self._reward / self._decisions,
            delivered=self._delivered,
            steps_per_second=self._decisions / max(now - self._since, 1e-9),
        )
        self.rows.append(row)
        self._reward, self._decisions, self._delivered, self._since = 0.0, 0, 0, now
        return row


def write_metrics(rows: list[Metrics], path: Path) -> None:
    """Write one Parquet row per entry, a column per field."""
    columns = {field.name: [getattr(row, field.name) for row in rows] for field in fields(Metrics)}
    types = {"int": pa.int64(), "float": pa.float64()}
    schema = pa.schema([(field.name, types[str(field.type)]) for field in fields(Metrics)])
    pq.write_table(pa.table(columns, schema=schema), path)


def read_metrics(path: Path) -> list[Metrics]:
    """Read back what `write_metrics` wrote."""
    return [Metrics(**row) for row in pq.read_table(path).to_pylist()]
