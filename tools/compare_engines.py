"""Let deployed controllers drive teams in both engines, with and without a profile, and compare them.

    python tools/compare_engines.py                         # measure teams of paper and robotarium, print
    python tools/compare_engines.py paper-8 --seeds 0 1 2   # some teams only
    python tools/compare_engines.py paper-8 --odometry 0.3  # robots that count the turns of their wheels
    python tools/compare_engines.py --known                 # print only what --out holds

Every run is one episode, driven by `robosim.deploy.Controller` through readings and wheel speeds alone. Each
is a line of --out as soon as it is over; stopped, the same command goes on. Seeds come one after the other,
so that all teams have as many. The table is in Markdown: pellets and touches in an episode, mean over seeds,
with the standard deviation of the pellets, and the share of them that is kept.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import statistics
import sys
import time
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from robosim.arena import load_arena
from robosim.control.policy import find_policy, load_policy, policy_names, team_digest
from robosim.deploy.controller import Controller
from robosim.deploy.simulated import ENGINES, EngineKind, make_stand_in
from robosim.envs.profile import ProfileConfig, load_profile
from robosim.errors import InputError
from robosim.files import whole_file
from robosim.robot.drivers import STOP
from robosim.world.draws import draw_episode

ROOT = Path(__file__).resolve().parent.parent
ARENAS = ("paper", "robotarium")


def shipped_teams() -> list[str]:
    """Return the policies whose cards name one of the arenas compared, smaller teams first."""
    cards = {name: load_policy(name).card for name in policy_names()}
    names = [name for name, card in cards.items() if card.arena.name in ARENAS]
    return sorted(names, key=lambda name: (cards[name].arena.name, cards[name].robots))


def fingerprint(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


@cache
def weights(team: str) -> str:
    return team_digest(find_policy(team))[:12]


@cache
def model(team: str) -> str:
    """Return a fingerprint of the MuJoCo model of a team's arena, with one robot."""
    from robosim.deploy.mujoco.model import model_text

    arena = load_arena(load_policy(team).card.env.arena)
    draws, _ = draw_episode(arena, 1, np.random.default_rng(0))
    return fingerprint(model_text(arena, draws).encode())


class Noise(NamedTuple):
    """What goes wrong in a run."""

    profile: str = ""
    """By its name; empty for nothing."""
    odometry: float | None = None
    """`SensingConfig.odometry`."""

    @property
    def config(self) -> ProfileConfig | None:
        if not self.profile:
            return None
        profile = load_profile(self.profile)
        if self.odometry is None:
            return profile
        return profile.changed(sensing=profile.sensing.changed(odometry=self.odometry))

    def __str__(self) -> str:
        if not self.profile:
            return "exact"
        return self.profile + ("" if self.odometry is None else f", odometry {self.odometry:g}")


def about(team: str, engine: EngineKind, noise: Noise, seed: int, decisions: int) -> dict[str, Any]:
    """Return what a run depends on."""
    counted = {} if noise.odometry is None else {"odometry": noise.odometry}
    return counted | {
        "team": team,
        "weights": weights(team),
        "engine": engine,
        "version": version(engine),
        "model": model(team) if engine == "mujoco" else "",
        "profile": noise.profile,
        "seed": seed,
        "decisions": decisions,
    }


def run(team: str, engine: EngineKind, noise: Noise, seed: int, decisions: int) -> dict[str, Any]:
    """Drive an episode and return what came of it, counts over all robots."""
    policy = load_policy(team)
    controller = Controller(policy, name=team)
    config = controller.config.changed(profile=None, pellet_gradient=0.0)
    robots = make_stand_in(engine, config, seed=seed, profile=noise.config)
    counts = dict.fromkeys(("touches", "wall_touches", "pellet_touches", "torn", "stopped"), 0)
    began = time.thread_time()
    for _ in range(decisions):
        actions = np.full(controller.robots, STOP)
        for _ in range(robots.arena.timing.control_steps):
            command = controller.step(robots.readings(), robots.now)
            actions = actions if command.actions is None else command.actions
            counts["stopped"] += sum(map(bool, command.stopped))
            robots.obey(command)
        state = robots.world.state
        touched = state.touched[:, 0] & (actions != STOP)
        for kind, name in enumerate(("touches", "wall_touches", "pellet_touches")):
            counts[name] += int(touched[kind].sum())
        counts["torn"] += int(state.lost.sum())
    return {
        "robots": controller.robots,
        "arena": robots.arena.name,
        "pellets": int(robots.world.state.delivered[0]),
        **counts,
        "speed": round(robots.now / (time.thread_time() - began), 1),
    }


class Records:
    """Runs, each made once and kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def find(self, wanted: dict[str, Any]) -> dict[str, Any] | None:
        # A run without odometry says nothing of it.
        alike = (line for line in self.lines if line.get("odometry") == wanted.get("odometry"))
        return next((line for line in alike if wanted.items() <= line.items()), None)

    def add(self, line: dict[str, Any]) -> None:
        self.lines.append(line)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self._path) as part:
            part.write_text("".join(json.dumps(one) + "\n" for one in self.lines), encoding="utf-8")


def measure(records: Records, teams: list[str], options: argparse.Namespace) -> None:
    noises = Noise(), Noise(options.profile, options.odometry)
    for seed, team, noise, engine in itertools.product(options.seeds, teams, noises, options.engines):
        what = about(team, engine, noise, seed, options.decisions)
        if records.find(what) is None:
            line = what | run(team, engine, noise, seed, options.decisions)
            records.add(line)
            print(
                f"seed {seed} {team:<20}{engine:<8}{noise!s:<26}{line['pellets']:4d} pellets"
                f"{line['touches']:7d} touches{line['torn']:4d} torn   {line['speed']:.1f} times real time",
                flush=True,
            )


def table(records: Records, teams: list[str], options: argparse.Namespace) -> Iterator[str]:
    """Yield the table's lines: seeds that all cases of a team have."""
    exact, noise = Noise(), Noise(options.profile, options.odometry)
    cases: list[tuple[EngineKind, Noise]] = [
        ("pymunk", exact), ("mujoco", exact), ("pymunk", noise), ("mujoco", noise)
    ]  # fmt: skip
    heads = ["pymunk", "MuJoCo", "kept", f"pymunk, {noise}", f"MuJoCo, {noise}", "kept"]
    yield _line(["team", "seeds", *heads, "touches, in the same order"])
    yield "|---|---|---|---|---|---|---|---|---|"
    for team in teams:
        runs = {
            case: {
                seed: found
                for seed in options.seeds
                if (found := records.find(about(team, *case, seed, options.decisions)))
            }
            for case in cases
        }
        seeds = sorted(set.intersection(*(set(found) for found in runs.values())))
        if not seeds:
            continue
        pellets = [[runs[case][seed]["pellets"] for seed in seeds] for case in cases]
        touches = [f"{statistics.mean(runs[case][seed]['touches'] for seed in seeds):.0f}" for case in cases]
        shares = [_kept(pellets[0], pellets[1]), _kept(pellets[0], pellets[3])]
        shown = [_spread(one) for one in pellets]
        yield _line(
            [f"`{team}`", len(seeds), *shown[:2], shares[0], *shown[2:], shares[1], ", ".join(touches)]
        )


def _kept(before: list[int], after: list[int]) -> str:
    return f"{100 * sum(after) / sum(before):.0f} %" if sum(before) else "-"


def _spread(values: list[int]) -> str:
    return f"{statistics.mean(values):.1f}" + (
        f" ({statistics.stdev(values):.1f})" if len(values) > 1 else ""
    )


def _line(cells: list[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "teams", nargs="*", help="policies; by default those that ship for the arenas compared"
    )
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=list(ENGINES))
    parser.add_argument("--profile", default="robotarium", help="beside no profile at all")
    parser.add_argument("--odometry", type=float, help="weight of a fix, for robots that count their wheels")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--decisions", type=int, default=1000)
    parser.add_argument("--known", action="store_true", help="print what --out holds, and measure nothing")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/results/engines.jsonl")
    options = parser.parse_args()
    records, teams = Records(options.out), options.teams or shipped_teams()
    if not options.known:
        measure(records, teams, options)
    for row in table(records, teams, options):
        print(row)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(str(error))
