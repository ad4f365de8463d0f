"""What a record keeps of an evaluation and of a training: numbers for each episode, and short curves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from robosim.analysis.measure.metrics import (
    MetricValue,
    NotDefined,
    active_fraction,
    clog_count,
    clogged_share,
    closest_approach,
    wheel_energy,
    workload_gini,
)
from robosim.analysis.measure.monitor import Episode, delivered_over_time
from robosim.analysis.measure.strategy import Strategy, classify
from robosim.control.card import Evaluation
from robosim.learning.metrics import Metrics

MOST_POINTS = 50
"""Points of the pellets over the first episode."""
LONGEST_CURVE = 40
"""Points of a learning curve."""

Rows = dict[str, list[float]]


def is_strategy(strategy: Strategy) -> Callable[[Episode], MetricValue]:
    """Return the metric that is 1 in an episode of that strategy and 0 in any other: its mean is a share."""
    return lambda episode: float(classify(episode).strategy is strategy)


FIGURES: Mapping[str, Callable[[Episode], MetricValue]] = {
    "wheel_energy": wheel_energy,
    "gini": workload_gini,
    "closest": closest_approach,
    "active_fraction": active_fraction,
    "clogs": clog_count,
    "clogged_share": clogged_share,
    "one_at_a_time": is_strategy(Strategy.ONE_AT_A_TIME),
    "bucket_brigade": is_strategy(Strategy.BUCKET_BRIGADE),
}
"""Figures of an episode that was watched, by the names in a record."""


def evaluation_figures(evaluation: Evaluation, episodes: Sequence[Episode]) -> Rows:
    """Return the figures of an evaluation by name, a number for each episode in their order.

    `touches` are the evaluation's collisions. Episodes in which a figure is not defined are left out of it,
    and a figure that none has is left out whole.
    """
    figures: Rows = {
        "pellets": [float(total) for total in evaluation.totals],
        "touches": [float(count) for count in evaluation.collisions],
    }
    for name, compute in FIGURES.items():
        values = [compute(episode) for episode in episodes]
        if defined := [value for value in values if not isinstance(value, NotDefined)]:
            figures[name] = defined
    return figures


def evaluation_series(evaluation: Evaluation, episodes: Sequence[Episode]) -> Rows:
    """Return what has no one number for each episode.

    `robot_pellets` [episodes * robots]: of each robot in the first episode, then in the second, and so on.
    `pellets_by_then` [n]: delivered in the first episode by its decision `round(T k / n)`, k = 1 ... n, with
    T the episode's decisions and n at most 50.
    """
    first = episodes[0]
    steps, delivered = delivered_over_time(first)
    points = min(MOST_POINTS, first.decisions)
    then = np.round(first.decisions * np.arange(1, points + 1) / points)
    by_then = delivered.sum(axis=1)[np.searchsorted(steps, then, side="right") - 1]
    return {
        "robot_pellets": [float(pellets) for episode in evaluation.delivered for pellets in episode],
        "pellets_by_then": [float(pellets) for pellets in by_then],
    }


def learning_curve(rows: Sequence[Metrics]) -> Rows:
    """Return the figures of a training over stretches of it, at most 40 of about equal length.

    `learned` are the joint decisions at their ends, `learned_pellets` the pellets in 1000 decisions,
    `learned_reward` the reward for each decision and learning robot.
    """
    curve: Rows = {"learned": [], "learned_pellets": [], "learned_reward": []}
    for stretch in np.array_split(np.arange(len(rows)), min(LONGEST_CURVE, len(rows)) or 1):
        part = [rows[number] for number in stretch]
        if part:
            decisions = sum(row.decisions for row in part)
            curve["learned"].append(float(part[-1].step))
            curve["learned_pellets"].append(1000.0 * sum(row.delivered for row in part) / decisions)
            curve["learned_reward"].append(sum(row.reward * row.decisions for row in part) / decisions)
    return curve
