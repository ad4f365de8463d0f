"""Runs that were never run: folders and results as training and sweeps write them, with made-up numbers."""

import json

import numpy as np

from robosim.control.card import Evaluation
from robosim.envs.profile import load_profile
from robosim.experiments.keys import key_of
from robosim.experiments.results import Result, append_result
from robosim.learning.config import run_config
from robosim.learning.folder import RunFolder
from robosim.learning.metrics import Metrics, write_metrics

STEPS = 400


def evaluation(pellets, robots=2, controller="runs/x", seed=0, world="grid", under=None):
    """Return the evaluation of a team that delivered `pellets` in each episode, the first robot most.

    `under` is the profile, by what `load_profile` takes.
    """
    delivered = [(total - total // 3, total // 3, *[0] * (robots - 2))[:robots] for total in pellets]
    if robots == 1:
        delivered = [(total,) for total in pellets]
    return Evaluation(
        controller=controller, arena="paper", world=world, robots=robots, seed=seed, episode_steps=300,
        delivered=tuple(delivered), collisions=tuple(7 for _ in pellets),
        profile=None if under is None else load_profile(under),
    )  # fmt: skip


def folder(path, technique, seed, pellets, robots=2, rate=0.01, under=None, **options):
    """Write a finished run; its learning curve is `rate` pellets a decision from the first to the last."""
    config = run_config(technique, robots=robots, world="grid", seed=seed, steps=STEPS, **options)
    run = RunFolder(path)
    run.begin(config, "robosim train")
    rows = [
        Metrics(
            step=step, decisions=100, episode=0, stage="together", stage_step=step, robots=robots,
            learning=robots, reward=0.0, delivered=round(100 * rate), collisions=0.0, blocked=0.0,
            steps_per_second=1.0, figures={},
        )
        for step in range(100, STEPS + 1, 100)
    ]  # fmt: skip
    write_metrics(rows, run.metrics)
    run.write_evaluation(evaluation(pellets, robots, str(path), seed, under=under))
    run.policy.mkdir()
    run.finish(STEPS, 1.0)
    return path


def result(path, technique, seed, pellets, robots=2, learned=True, under=None, **options):
    """Add a line to a sweep's results: a team that learned, or a scripted controller."""
    measuring = {"episodes": len(pellets), "steps": 300} | ({} if under is None else {"profile": under})
    one = evaluation(pellets, robots)
    series = {
        "robot_pellets": [float(n) for episode in one.delivered for n in episode],
        "pellets_by_then": [float(pellets[0]) * share for share in (0.25, 0.5, 0.75, 1.0)],
    }
    if learned:
        config = run_config(technique, robots=robots, world="grid", **options)
        table = config.model_dump(mode="json", exclude_none=True)
        points = np.linspace(100.0, STEPS, 4).tolist()
        series |= {"learned": points, "learned_pellets": [1.0, 2.0, 3.0, 4.0], "learned_reward": [0.0] * 4}
    else:
        table = {"env": {"robots": robots, "world": "grid", "arena": "paper"}}
    table |= {"run": {"technique": technique, "seed": seed}, "evaluation": measuring}
    figures = {"pellets": list(map(float, pellets)), "touches": [3.0] * len(pellets)}
    append_result(path, Result(key_of(table), table, figures, 1.0, {"processor": "x"}, series))


def rekey(path):
    """Give each record in a file of results that was changed the key of its configuration."""
    records = [json.loads(line) for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps(one | {"key": key_of(one["config"])}) + "\n" for one in records))
