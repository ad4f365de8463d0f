"""`robosim deploy engines`: a team in both physics, side by side in one recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robosim.cli.deploy import Engines
    from robosim.deploy.simulated import EngineKind

NAMES: dict[EngineKind, str] = {"pymunk": "pymunk, where teams learn", "mujoco": "MuJoCo, the second physics"}


def record_engines(asked: Engines) -> tuple[int, dict[str, int]]:
    """Record what is asked for; return how many decisions, and the pellets delivered in each engine.

    An interrupt (Ctrl-C) ends it early: what has been recorded is kept. InputError for wrong input.
    """
    from robosim.control.policy import load_policy
    from robosim.deploy.controller import Controller
    from robosim.deploy.simulated import ENGINES, driven, make_stand_in
    from robosim.envs.config import MOST_STEPS
    from robosim.envs.vector import MAX_SEED
    from robosim.errors import whole_number
    from robosim.learning.interrupts import hold_interrupts
    from robosim.playback.beside import recording_beside

    whole_number("--decisions", asked.decisions, 1, MOST_STEPS)
    whole_number("--seed", asked.seed, 0, MAX_SEED)
    policy, name = load_policy(asked.policy), Path(asked.policy).name
    controllers = [Controller(policy, asked.robots, asked.arena, name=name) for _ in ENGINES]
    first = controllers[0]
    # As in an evaluation: how a policy learned does not change what it is tried on.
    config = first.config.changed(pellet_gradient=0.0, profile=None, episode_steps=0)
    teams = [make_stand_in(engine, config, seed=asked.seed, profile=asked.profile) for engine in ENGINES]
    runs = [driven(*both, asked.decisions) for both in zip(controllers, teams, strict=True)]
    about = {"policy": name, "seed": str(asked.seed), "profile": asked.profile or "none"}
    scenes = {str(engine): NAMES[engine] for engine in ENGINES}
    beside = recording_beside(asked.save, first.arena, robots=first.robots, scenes=scenes, about=about)
    delivered = dict.fromkeys(map(str, ENGINES), 0)
    every, played = max(1, asked.decisions // 10), 0
    with hold_interrupts() as interrupted, beside as recorders:
        for frames in zip(*runs, strict=True):
            for engine, frame in zip(ENGINES, frames, strict=True):
                recorders[engine].add(frame)
                delivered[engine] = int(frame.delivered.sum())
            played = frames[0].step
            if played and played % every == 0:
                print(f"step {played}/{asked.decisions}  {delivered}", flush=True)
            if interrupted():
                break
    return played, delivered
