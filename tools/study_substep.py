"""How much the length of a substep matters: pellets that the lane keeper delivers, and where a pellet stops.

    python tools/study_substep.py [--arena paper --robots 8 --envs 16 --decisions 5000 --json FILE]

Every row runs the same seeds. Runs with different substeps part within seconds, as contacts do, so only their
averages can be compared: the standard error says how well. The stopping distance is that of one pellet let go
at a robot's top speed, against Coulomb's.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from robosim.arena import Arena, load_arena
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.robot.sheet import GRAVITY

SUBSTEPS = (6, 12, 24, 48)


@dataclass(frozen=True)
class Row:
    substeps: int
    substep_ms: float
    delivered: float
    """Mean over environments."""
    error: float
    """Its standard error."""
    stopping_percent: float
    """Of a pellet at top speed, more than Coulomb's."""
    us_per_decision: float
    """Of one environment, controller included."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arena", default="paper")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--envs", type=int, default=16)
    parser.add_argument("--decisions", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    arena = load_arena(args.arena)
    rows = []
    for substeps in SUBSTEPS:
        finer = replace(arena, timing=replace(arena.timing, substeps=substeps))
        rows.append(measure(finer, args.robots, args.envs, args.decisions, args.seed))
    finest = rows[-1].delivered
    print("| substeps | substep, ms | delivered | against the finest | a pellet stops | us a decision |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row.substeps} | {row.substep_ms:.2f} | {row.delivered:.1f} +- {row.error:.1f} "
            f"| {100 * (row.delivered / finest - 1):+.1f} % | {row.stopping_percent:+.1f} % "
            f"| {row.us_per_decision:.0f} |"
        )
    if args.json:
        args.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def measure(arena: Arena, robots: int, envs: int, decisions: int, seed: int) -> Row:
    env = VectorEnv(arena, robots=robots, num_envs=envs, seed=seed, episode_steps=decisions, autoreset=False)
    controller = LanesController()
    observation = env.reset()
    controller.reset(env)
    started = time.process_time()
    for _ in range(decisions):
        observation = env.step(controller.act(env, observation)).observation
    spent = time.process_time() - started
    delivered = env.delivered.sum(axis=1)
    return Row(
        substeps=arena.timing.substeps,
        substep_ms=1e3 * arena.timing.substep,
        delivered=float(delivered.mean()),
        error=float(delivered.std(ddof=1) / math.sqrt(envs)),
        stopping_percent=100.0 * (stopping_distance(arena) - 1.0),
        us_per_decision=1e6 * spent / decisions / envs,
    )


def stopping_distance(arena: Arena) -> float:
    """Return how far a pellet slides from top speed, as a multiple of v^2 / (2 mu g).

    The solver moves a body with the speed it had before friction took its part of the substep.
    """
    speed, slowing = arena.robot.top_speed, arena.pellets.friction * GRAVITY
    steps = np.arange(math.ceil(speed / slowing / arena.timing.substep) + 1)
    distance = np.maximum(speed - slowing * arena.timing.substep * steps, 0.0).sum() * arena.timing.substep
    return float(distance / (speed**2 / (2.0 * slowing)))


if __name__ == "__main__":
    main()
