"""`robosim demo`: train, evaluate, record; everything in a few minutes."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

ROBOTS = 2
STEPS = 30_000
"""Decisions to learn from: enough for two robots to share the tunnel well."""
EPISODES = 3
EPISODE_STEPS = 1000
"""Decisions in an episode of the comparison: some nine trips of a robot."""


@dataclass(frozen=True)
class Demo:
    """Train a small team, compare it with scripted ones, and record a playback."""

    out: Path = Path("demo")
    """Folder for the trained run and the recording; an earlier run in it is kept."""
    steps: int = STEPS
    """Decisions to learn from."""

    def run(self) -> None:
        """Run the subcommands one after the other, each shown as a user would type it."""
        from robosim.cli.evaluate import Evaluate
        from robosim.cli.play import Play
        from robosim.cli.train import begin
        from robosim.learning.config import run_config

        folder = _unused_folder(self.out)
        recording = folder.with_suffix(".rrd")

        _announce(
            f"robosim train --robots {ROBOTS} --steps {self.steps} --evaluation-episodes 0", "--out", folder
        )
        begin(run_config(robots=ROBOTS, steps=self.steps, evaluation_episodes=0), folder)

        for policy in (str(folder), "lanes", "random"):
            options = f"--robots {ROBOTS} --episodes {EPISODES} --steps {EPISODE_STEPS}"
            _announce("robosim evaluate", policy, options)
            Evaluate((policy,), robots=ROBOTS, episodes=EPISODES, steps=EPISODE_STEPS).run()

        _announce("robosim play", folder, f"--steps {EPISODE_STEPS} --save", recording)
        Play(str(folder), steps=EPISODE_STEPS, save=recording).run()


def _unused_folder(parent: Path) -> Path:
    """Return parent/run, or the first of run-2, run-3 ... that does not exist yet."""
    names = chain(["run"], (f"run-{number}" for number in count(2)))
    return next(parent / name for name in names if not (parent / name).exists())


def _announce(*words: str | Path) -> None:
    command = " ".join(shlex.quote(str(word)) if isinstance(word, Path) else word for word in words)
    print(f"\n$ {command}", flush=True)
