"""Draw the picture of docs/mixed-teams.md: a mixed team of four at work, driven by the lane keeper.

python tools/draw_mixed_team.py docs/images/mixed-team.png
"""

from __future__ import annotations

import sys
from pathlib import Path

from robosim.analysis.figures.moments import Moment, save_moments
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv

DECISIONS = (0, 80, 400)
"""After which the team is drawn."""


def moments() -> list[Moment]:
    """Return what the team looks like after each of `DECISIONS`."""
    env, lanes, seen = VectorEnv("relay", robots=4, seed=1, autoreset=False), LanesController(), []
    observation = env.reset()
    lanes.reset(env)
    while True:
        if env.steps_taken in DECISIONS:
            handed, home = int(env.handed_over.sum()), int(env.delivered.sum())
            title = f"after {env.steps_taken} decisions: {handed} pellets handed over, {home} brought home"
            seen.append(Moment.of(env.frame(), env.arena, title))
        if env.steps_taken == max(DECISIONS):
            return seen
        observation = env.step(lanes.act(env, observation)).observation


if __name__ == "__main__":
    save_moments(moments(), Path(sys.argv[1]))
