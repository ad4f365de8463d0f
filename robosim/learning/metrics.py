"""The figures of a run as it goes on, and the Parquet file that keeps them."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from robosim.files import whole_file


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
    epsilon: float
    """Share of random actions of the learning robots at the end of the row, in the environment that explores
    most."""
    learning_rate: float
    """Adam's step size at the end of the row."""
    loss: float
    """Mean squared error of the latest batch, in scaled rewards, mean over robots; NaN before learning."""
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


class MetricsLog:
    """Adds up what happens in a run and cuts it into rows."""

    def __init__(self) -> None:
        self.rows: list[Metrics] = []
        self.sums = Sums()
        self._since = time.perf_counter()

    def begin_stage(self) -> None:
        """Count episodes and decisions of the stage anew."""
        self.sums.stage_step = self.sums.episodes = self.sums.delivered_before = 0

    def add(
        self,
        reward: NDArray[np.float32],
        delivered: NDArray[np.int64],
        ended: NDArray[np.bool_],
        collided: NDArray[np.bool_],
        blocked: NDArray[np.bool_],
    ) -> None:
        """Take in one decision of every environment.

        `reward` is [envs, learning robots], `delivered` (in the episode so far), `collided` and `blocked` are
        [envs, robots], `ended` [envs].
        """
        sums, totals = self.sums, delivered.sum(axis=1)
        sums.step += len(reward)
        sums.stage_step += len(reward)
        sums.decisions += len(reward)
        sums.reward += float(reward.sum()) / reward.shape[1]
        sums.delivered += int(totals.sum()) - sums.delivered_before
        # What ended episodes delivered is not subtracted again: the next ones start at nothing.
        sums.delivered_before = int(totals[~ended].sum())
        sums.episodes += int(ended.sum())
        sums.collisions += int(np.count_nonzero(collided))
        sums.blocked += np.count_nonzero(blocked) / blocked.shape[1]

    def cut(
        self, stage: str, robots: int, learning: int, epsilon: float, learning_rate: float, loss: float
    ) -> Metrics:
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
            epsilon=epsilon,
            learning_rate=learning_rate,
            loss=loss,
            reward=sums.reward / sums.decisions,
            delivered=sums.delivered,
            collisions=sums.collisions / sums.decisions,
            blocked=sums.blocked / sums.decisions,
            steps_per_second=sums.decisions / max(now - self._since, 1e-9),
        )
        self.rows.append(row)
        sums.reward = sums.blocked = 0.0
        sums.decisions = sums.delivered = sums.collisions = 0
        self._since = now
        return row


def write_metrics(rows: list[Metrics], path: Path) -> None:
    """Write one Parquet row per entry, a column per field."""
    columns = {field.name: [getattr(row, field.name) for row in rows] for field in fields(Metrics)}
    types = {"int": pa.int64(), "float": pa.float64(), "str": pa.string()}
    schema = pa.schema([(field.name, types[str(field.type)]) for field in fields(Metrics)])
    with whole_file(path) as part:
        pq.write_table(pa.table(columns, schema=schema), part)


def read_metrics(path: Path) -> list[Metrics]:
    """Read back what `write_metrics` wrote."""
    return [Metrics(**row) for row in pq.read_table(path).to_pylist()]
