"""What was measured as tables for other programs: events and flow as Parquet, all metrics as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Any

import pyarrow as pa

import robosim
from robosim.analysis.clogs.clog import TRANSITS, Clog, clogged_decisions
from robosim.analysis.measure.metrics import (
    NO_TIME,
    NO_TUNNEL,
    MetricValue,
    NotDefined,
    Summary,
    clogs,
    require_finite,
)
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.strategy import classify
from robosim.control.card import Evaluation
from robosim.discretise.modes import Mode
from robosim.world.contacts import ContactKind

SENSITIVITY = (1.0, 2.0, 3.0, 4.0)
"""Free-flow transit times k for which the share of time clogged is given."""

_WORD_OF_KIND = {
    ContactKind.ROBOT_ROBOT: "touches_of_robots",
    ContactKind.ROBOT_WALL: "touches_of_walls",
    ContactKind.ROBOT_PELLET: "touches_of_pellets",
}

TRIPS = pa.schema(
    [
        ("episode", pa.int64()),
        ("robot", pa.int64()),
        ("start", pa.int64()),
        ("end", pa.int64()),
        ("pellets", pa.int64()),
        *((f"{mode.name.lower()}_s", pa.float64()) for mode in Mode),
        *((_WORD_OF_KIND[kind], pa.float64()) for kind in ContactKind),
        ("impulse_Ns", pa.float64()),
        ("energy_J", pa.float64()),
    ]
)
"""Columns of trips.parquet: fields of `robosim.analysis.measure.trips.Trip`, start and end in decisions."""

CLOGS = pa.schema(
    [
        ("episode", pa.int64()),
        ("tunnel", pa.int64()),
        ("start", pa.int64()),
        ("end", pa.int64()),
        ("start_s", pa.float64()),
        ("duration_s", pa.float64()),
        ("members", pa.list_(pa.int64())),
        ("cause", pa.string()),
        ("ending", pa.string()),
        ("x_m", pa.float64()),
        ("y_m", pa.float64()),
        ("distance_m", pa.float64()),
        ("transits", pa.float64()),
    ]
)
"""Columns of clogs.parquet: fields of `robosim.analysis.clogs.clog.Clog`, start and end in decisions."""

VISITS = pa.schema(
    [
        ("episode", pa.int64()),
        ("robot", pa.int64()),
        ("tunnel", pa.int64()),
        ("start", pa.int64()),
        ("end", pa.int64()),
        ("entered", pa.string()),
        ("left", pa.string()),
        ("deepest_m", pa.float64()),
    ]
)
"""Columns of visits.parquet: the fields of `robosim.analysis.measure.visits.Visit`, ends by name."""

FLOW = pa.schema(
    [
        ("episode", pa.int64()),
        ("tunnel", pa.int64()),
        ("density_per_m", pa.float64()),
        ("flow_per_s", pa.float64()),
    ]
)
"""Columns of flow.parquet: the fields of `robosim.analysis.measure.traffic.Windows`, in order of time."""


def trip_table(episodes: Sequence[Episode]) -> pa.Table:
    """Return a row for each trip, episode by episode."""
    rows = [
        (number, *place, *trip.seconds, *trip.contacts, trip.impulse, trip.energy)
        for number, episode in enumerate(episodes)
        for trip in episode.trips
        for place in [(trip.robot, trip.start, trip.end, trip.pellets)]
    ]
    return _table(TRIPS, rows)


def visit_table(episodes: Sequence[Episode]) -> pa.Table:
    """Return a row for each visit to a tunnel, by episode and end."""
    rows = [
        (number, *visit[:4], visit.entered.name.lower(), visit.left.name.lower(), visit.deepest)
        for number, episode in enumerate(episodes)
        for visit in episode.traffic.visits
    ]
    return _table(VISITS, rows)


def flow_table(episodes: Sequence[Episode]) -> pa.Table:
    """Return a row for each tunnel in each stretch of 30 s, by episode and time."""
    rows = [
        (number, *row)
        for number, episode in enumerate(episodes)
        for row in zip(*(values.tolist() for values in episode.traffic.windows), strict=True)
    ]
    return _table(FLOW, rows)


def clog_table(episodes: Sequence[Episode]) -> pa.Table:
    """Return a row for each clog, episode by episode."""
    return _table(CLOGS, [tuple(record.values()) for record in clog_records(episodes)])


def clog_records(episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Return every clog as the columns of `CLOGS`."""
    return [
        _clog_record(number, clog, episode.arena.timing.decision_period)
        for number, episode in enumerate(episodes)
        for clog in clogs(episode)
    ]


def clogged_share_by_transits(episodes: Sequence[Episode]) -> dict[float, MetricValue]:
    """Return for each k of `SENSITIVITY` the share of time clogged, if clogs last longer than k transits."""
    decisions = sum(episode.decisions for episode in episodes)
    if episodes[0].tunnels.count == 0:
        return dict.fromkeys(SENSITIVITY, NO_TUNNEL)
    if decisions == 0:
        return dict.fromkeys(SENSITIVITY, NO_TIME)
    return {
        k: sum(clogged_decisions(clogs(one, k), one.decisions) for one in episodes) / decisions
        for k in SENSITIVITY
    }


def counted(kinds: Iterable[Enum]) -> dict[str, int]:
    """Return how often each cause or ending occurs, the most frequent first."""
    return dict(Counter(str(kind.value) for kind in kinds).most_common())


def metrics_record(
    evaluation: Evaluation, episodes: Sequence[Episode], summaries: Sequence[Summary], command: str
) -> dict[str, Any]:
    """Return all that metrics.json holds; what is not defined is null and has a `reason`."""
    every = [clog for episode in episodes for clog in clogs(episode)]
    return {
        "robosim": robosim.__version__,
        "command": command,
        "evaluation": evaluation.model_dump(mode="json"),
        "metrics": [
            {
                "name": summary.metric.name,
                "unit": summary.metric.unit,
                "definition": summary.metric.definition,
                "mean": _value_record(summary.mean),
                "std": _value_record(summary.std),
                "n": len(summary.defined),
                "episodes": [_value_record(value) for value in summary.values],
            }
            for summary in summaries
        ],
        "strategy": [
            {"strategy": found.strategy.value, "reason": found.reason} for found in map(classify, episodes)
        ],
        "clogs": {
            "transits": TRANSITS,
            "clogged_share_by_transits": {
                f"{k:g}": _value_record(share) for k, share in clogged_share_by_transits(episodes).items()
            },
            "causes": counted(clog.cause for clog in every),
            "endings": counted(clog.ending for clog in every),
            "found": clog_records(episodes),
        },
    }


def _table(schema: pa.Schema, rows: Sequence[Sequence[Any]]) -> pa.Table:
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(schema)
    # What a world does not know is NaN in the monitor and null in a file, or sums over a column would be NaN.
    arrays = [
        pa.array(column, field.type, from_pandas=True) for column, field in zip(columns, schema, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _clog_record(number: int, clog: Clog, period: float) -> dict[str, Any]:
    return {
        "episode": number,
        "tunnel": clog.tunnel,
        "start": clog.start,
        "end": clog.end,
        "start_s": clog.start * period,
        "duration_s": (clog.end - clog.start) * period,
        "members": list(clog.members),
        "cause": clog.cause.value,
        "ending": clog.ending.value,
        "x_m": clog.place[0],
        "y_m": clog.place[1],
        "distance_m": clog.distance,
        "transits": clog.transits,
    }


def _value_record(value: MetricValue) -> dict[str, float | str | None]:
    if isinstance(value, NotDefined):
        return {"value": None, "reason": value.reason}
    return {"value": require_finite(value)}
