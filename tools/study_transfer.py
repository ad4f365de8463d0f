"""Measure teams in both worlds: what a policy that learned in one brings in the other.

    python tools/study_transfer.py paper-4 runs/grid-4-0 runs/grid-4-1 ... [--seconds 1500] [--episodes 5]

Every policy runs in its own arena, in physics and in the grid, for the same simulated time; `lanes` runs
beside it with as many robots. Run folders that follow each other and differ only in the last number of their
name are seeds of one training, and share a row: the mean over them, and the standard deviation between them.
Prints a table in Markdown.
"""

from __future__ import annotations

import argparse
import itertools
import re
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.learned import LearnedController
from robosim.world.factory import WORLD_KINDS, make_world

World = Literal["physics", "grid"]


class Settings(NamedTuple):
    """What every evaluation shares."""

    seconds: float
    """Of simulated time in an episode."""
    episodes: int
    seed: int


def decisions_in(seconds: float, arena: str, robots: int, world: World) -> int:
    """Return how many decisions of that world last so long."""
    period = make_world(world, load_arena(arena), robots, 1).arena.timing.decision_period
    return round(seconds / period)


def pellets(controller: str, arena: str, robots: int, world: World, settings: Settings) -> float:
    """Return the pellets in an episode, mean over episodes."""
    steps = decisions_in(settings.seconds, arena, robots, world)
    team = make_controller(controller)
    env = environment_for(
        team, arena, robots, world, num_envs=settings.episodes, seed=settings.seed, episode_steps=steps
    )
    return evaluate(team, env, settings.episodes, settings.seed).mean


def rows(policies: list[str], settings: Settings) -> Iterator[str]:
    """Yield a row for each training: team, robots, where it learned, and pellets and share in each world."""
    for _, group in itertools.groupby(policies, key=_training):
        yield _row(list(group), settings)


def _training(policy: str) -> str:
    """Return what the seeds of a training have in common; a policy by its name is a training of its own."""
    return re.sub(r"-\d+$", "", policy) if Path(policy).is_dir() else policy


def _row(group: list[str], settings: Settings) -> str:
    team = make_controller(group[0])
    if not isinstance(team, LearnedController):
        raise SystemExit(f"{group[0]} is a scripted controller: give trained policies.")
    env = team.policy.card.env
    one = Path(group[0]).name
    name = one if len(group) == 1 else f"{_training(group[0]).rpartition('/')[2]}, {len(group)} seeds"
    cells = [name, str(env.robots), env.world]
    for world in WORLD_KINDS:
        brought = [pellets(policy, env.arena, env.robots, world, settings) for policy in group]
        reference = pellets("lanes", env.arena, env.robots, world, settings)
        spread = f" ± {statistics.stdev(brought):.1f}" if len(brought) > 1 else ""
        mean = statistics.mean(brought)
        cells += [f"{mean:.1f}{spread}", f"{100 * mean / reference:.0f} %" if reference else "-"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("policies", nargs="+")
    parser.add_argument("--seconds", type=float, default=1500.0)
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    settings = Settings(options.seconds, options.episodes, options.seed)
    print("| team | robots | learned in | physics | of `lanes` | grid | of `lanes` |")
    print("|---|---|---|---|---|---|---|")
    for row in rows(options.policies, settings):
        print(row, flush=True)


if __name__ == "__main__":
    main()
