"""The curriculum: a small team learns together, then newcomers join it one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robosim.errors import InputError
from robosim.learning.config import RunConfig
from robosim.learning.metrics import Metrics

Ending = Literal["steady", "budget"]
"""What ended a stage."""
_WINDOWS = 5
"""The return is compared between fifths of a stage's budget."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of a run in which the same robots learn."""

    name: str
    robots: int
    """In the tunnel."""
    learning: int
    """How many of them learn: the last ones. Those before are frozen."""
    share: float
    """Of the run's decisions, relative to the other stages."""
    explores: bool
    """Exploration begins anew; otherwise its share stays at the end's."""

    @property
    def frozen(self) -> int:
        """Robots that act and do not learn."""
        return self.robots - self.learning


def plan_stages(config: RunConfig, trained: int = 0) -> tuple[Stage, ...]:
    """Return the stages of a run; `trained` robots come from the policy that it starts from.

    Without a curriculum there is one stage. With one (the paper's section on curriculum learning),
    `first_team` robots learn together, then each newcomer beside frozen ones, and with `fine_tune`
    all once more. The first stage takes `first_share` of the decisions, or without it counts as many
    shares as it has robots; a newcomer's counts one. InputError when a policy to start from does not go
    with the team.
    """
    robots, schedule = config.env.robots, config.schedule
    if trained > robots:
        raise InputError(f"start_from holds {trained} robots, but must hold at most the team's {robots}.")
    if not schedule.curriculum:
        if trained not in (0, robots):
            raise InputError(
                f"start_from holds {trained} robots, but must hold the team's {robots} without a curriculum."
            )
        return (Stage("together", robots, robots, 1.0, explores=not trained),)
    stages: list[Stage] = []
    if not trained:
        first = min(schedule.first_team, robots)
        stages.append(Stage("first team", first, first, _first_share(config, first), explores=True))
        trained = first
    fresh = schedule.newcomer == "scratch"
    stages += [
        Stage(f"newcomer {number}", number, 1, 1.0, explores=fresh)
        for number in range(trained + 1, robots + 1)
    ]
    if schedule.fine_tune > 0.0:
        rest = sum(stage.share for stage in stages) or 1.0
        share = rest * schedule.fine_tune / (1.0 - schedule.fine_tune)
        stages.append(Stage("fine-tuning", robots, robots, share, explores=False))
    if not stages:
        raise InputError(
            f"start_from holds {trained} robots, but must hold less than the whole team without fine_tune."
        )
    return tuple(stages)


def _first_share(config: RunConfig, first: int) -> float:
    """Return how many shares the first stage counts, of which a newcomer's counts one."""
    schedule, newcomers = config.schedule, config.env.robots - first
    if schedule.first_share is None or not newcomers:
        return float(first)
    return newcomers * schedule.first_share / (1.0 - schedule.first_share - schedule.fine_tune)


def stage_budget(stages: Sequence[Stage], number: int, steps_left: int) -> int:
    """Return the joint decisions that stage `number` may take of what is left of the run."""
    shares = [stage.share for stage in stages[number:]]
    return max(1, round(steps_left * shares[0] / sum(shares)))


def is_steady(rows: Sequence[Metrics], budget: int, least_gain: float) -> bool:
    """Return whether a stage's return has stopped growing.

    That is so when the reward of the latest fifth of the budget exceeds that of the fifth before by less
    than the share `least_gain`, from three fifths on; with 0 never. `rows` are the stage's so far.
    """
    if least_gain <= 0.0 or not rows:
        return False
    now, window = rows[-1].stage_step, budget / _WINDOWS
    if now < 3 * window:
        return False
    latest = [row.reward for row in rows if row.stage_step > now - window]
    before = [row.reward for row in rows if now - 2 * window < row.stage_step <= now - window]
    if not latest or not before:
        return False
    return float(np.mean(latest)) < float(np.mean(before)) + least_gain * abs(float(np.mean(before)))
