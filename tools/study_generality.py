"""Measure one team for all: what it brings in each arena at each size, seen in training or not.

    python tools/study_generality.py any [--sizes 1 2 4 8 16 32] [--episodes 4] [--only shipped random ...]

Three kinds of arenas: those that ship with the standard robot, those in examples/arenas, which no training
saw, and random ones of seeds that no training drew from. Beside the team run `lanes`, and the policy that
ships for that arena and size, if any, over episodes of the same seed. Each measurement is a line of --out;
stopped, the same command goes on, and with --known it prints what there is and measures nothing. Prints a
table for each kind in Markdown: pellets in an episode (mean over episodes), shares, and the longest time
without any delivery, in decisions, of the team and of `lanes`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from robosim.arena import load_arena
from robosim.arena.random import random_arena
from robosim.control.card import Evaluation
from robosim.control.controller import Controller, make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.policy import find_policy, load_policy, policy_names, team_digest
from robosim.errors import InputError
from robosim.files import whole_file

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ("paper", "single-lane", "long", "s-bend", "two-tunnels")
"""With the standard robot and cell; `paper-grid` is `long` again, made for the grid."""
REPORTED_SEED = 10**12
"""Of the first random arena that is reported; trainings draw from far smaller ones."""


class Measure(NamedTuple):
    """Of a controller in an arena with some robots."""

    pellets: float
    """In an episode, mean over episodes."""
    worst: int
    """In the worst episode."""
    lapse: int
    """Longest time without any delivery, over all episodes, decisions; the end of an episode ends it."""


class Study:
    """Measurements, each made once and kept in a file."""

    def __init__(self, out: Path, episodes: int, seed: int, steps: int | None, known: bool) -> None:
        self._out = out
        self._measures = not known
        self._settings = {"episodes": episodes, "seed": seed, "steps": steps or 0}
        lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
        self._known = [json.loads(line) for line in lines]

    def measure(self, name: str, arena: str, robots: int) -> Measure | None:
        """Return what a controller does in an arena (name or text), measured now or before.

        None where it is not known and nothing is to be measured.
        """
        about: dict[str, Any] = {
            "controller": name,
            "weights": _weights(name),
            "arena": load_arena(arena).name,
        }
        about |= {"robots": robots, **self._settings}
        for known in self._known:
            if about.items() <= known.items():
                return Measure(known["pellets"], known["worst"], known["lapse"])
        if not self._measures:
            return None
        result = self._run(make_controller(name), arena, robots)
        measure = Measure(result.mean, min(result.totals), max(result.longest_lapse or (0,)))
        self._known.append(about | measure._asdict())
        self._out.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self._out) as part:
            part.write_text("".join(json.dumps(one) + "\n" for one in self._known), encoding="utf-8")
        return measure

    def _run(self, team: Controller, arena: str, robots: int) -> Evaluation:
        settings = self._settings
        episodes, seed = settings["episodes"], settings["seed"]
        env = environment_for(
            team, arena, robots, num_envs=episodes, seed=seed, episode_steps=settings["steps"] or None
        )
        return evaluate(team, env, episodes, seed)


def _weights(name: str) -> str:
    """Return a fingerprint of a policy; none of a scripted controller."""
    if name == "lanes":
        return ""
    return team_digest(find_policy(name))[:12]


def specialists() -> dict[tuple[str, int], str]:
    """Return the policies that ship for one arena, by that and their team's size: ARENA-ROBOTS by name."""
    cards = {name: load_policy(name).card for name in policy_names()}
    return {
        (card.arena.name, card.robots): name
        for name, card in cards.items()
        if name == f"{card.arena.name}-{card.robots}"
    }


def rows(study: Study, policy: str, arenas: dict[str, str], sizes: list[int]) -> Iterator[str]:
    """Yield the table's lines for arenas (name: name or text)."""
    special = specialists()
    heads = ("arena", "robots", "pellets", "worst episode", "of `lanes`", "of the specialised team")
    yield _line([*heads, "longest lapse", "that of `lanes`"])
    yield "|---|---|---|---|---|---|---|---|"
    for name, arena in arenas.items():
        own = [robots for place, robots in special if place == name]
        for robots in sorted({*sizes, *own}):
            team, lanes = study.measure(policy, arena, robots), study.measure("lanes", arena, robots)
            if team is None or lanes is None:
                continue
            other = special.get((name, robots))
            share = _share(team, study.measure(other, arena, robots)) if other else ""
            cells = [name, robots, f"{team.pellets:.1f}", team.worst, _share(team, lanes), share]
            yield _line([*cells, team.lapse, lanes.lapse])


def _share(team: Measure, other: Measure | None) -> str:
    return f"{100 * team.pellets / other.pellets:.0f} %" if other and other.pellets else "-"


def _line(cells: list[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("policy", help="policy by name, policy or run folder")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 4, 8, 16, 32])
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--steps", type=int, help="decisions in an episode; by default the arena's own")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--random-seed", type=int, default=REPORTED_SEED, help="of the first random arena")
    parser.add_argument("--random-arenas", type=int, default=10)
    parser.add_argument("--only", nargs="+", choices=("shipped", "examples", "random"))
    parser.add_argument("--known", action="store_true", help="print what --out holds, and measure nothing")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/results/generality.jsonl")
    options = parser.parse_args()
    files = sorted((ROOT / "examples/arenas").glob("*.toml"))
    seeds = range(options.random_seed, options.random_seed + options.random_arenas)
    kinds = {
        "shipped": {name: name for name in SHIPPED},
        "examples": {path.stem: str(path) for path in files},
        "random": {f"random-{seed}": random_arena(seed) for seed in seeds},
    }
    study = Study(options.out, options.episodes, options.seed, options.steps, options.known)
    for kind in options.only or kinds:
        print(f"\n{kind}\n")
        for row in rows(study, options.policy, kinds[kind], options.sizes):
            print(row, flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(str(error))
