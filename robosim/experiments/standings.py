"""Finished teams side by side: what each delivers in an episode, with an interval over its episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from robosim.control.card import Evaluation
from robosim.experiments.statistics import Estimate, estimate, mean


@dataclass(frozen=True, slots=True)
class Standing:
    """How one team did.

    Intervals are those of the mean over other episodes of the same team: they say nothing of other seeds of
    its training.
    """

    evaluation: Evaluation
    pellets: Estimate
    """Per episode, the mean."""
    collisions: Estimate
    """Per episode, the mean."""

    def as_record(self) -> dict[str, Any]:
        """Return everything as tables and lists, for a JSON file."""
        figures = {"pellets": asdict(self.pellets), "collisions": asdict(self.collisions)}
        return {**figures, "evaluation": self.evaluation.model_dump(mode="json")}


def standing(evaluation: Evaluation) -> Standing:
    """Return how a team did in its evaluation, with 95 % bootstrap intervals from three episodes on."""
    return Standing(evaluation, _mean(evaluation.totals), _mean(evaluation.collisions))


def _mean(per_episode: Sequence[int]) -> Estimate:
    return estimate(mean, np.array(per_episode, dtype=np.float64))
