"""Print what the faces of the batch cost: for each client its lines, and joint decisions a second.

    python tools/compare_faces.py [--seconds 2] [--rounds 3]

Clients that are not installed are left out, and named. All take the same random actions for four robots in
16 environments, or in one where a client knows single environments alone. They are measured in turn, several
times, and the best counts. Time is that of the processor, so that other work on the machine changes little.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROBOTS = 4
BATCH = 16
"""Environments side by side."""
WORLDS = ("physics", "grid")
_DRAWN = 64
"""Joint actions that are drawn beforehand, and taken again and again."""

Actions = NDArray[np.int64]
"""[drawn, envs, robots]."""
Step = Callable[[int], None]
"""Takes the decision of this number in every environment."""


@dataclass(frozen=True)
class Face:
    """A client, and how it comes by its environments."""

    client: str
    needs: str
    """Package that must be there."""
    code: str
    """Leaves the environments in `env`."""
    stepping: Callable[[Any, Actions], Step]
    """Begins an episode in them, and returns what takes decisions."""
    num_envs: int = BATCH

    @property
    def lines(self) -> int:
        return sum(bool(line) for line in self.code.splitlines())

    def make(self, world: str) -> Any:
        names: dict[str, Any] = {}
        exec(self.code.replace("robots=4", f"robots=4, world={world!r}"), names)
        return names["env"]


def step_batch(env: Any, actions: Actions) -> Step:
    env.reset()
    return lambda number: env.step(actions[number % _DRAWN])


def step_rows(env: Any, actions: Actions) -> Step:
    env.reset()
    rows = actions.reshape(_DRAWN, -1)
    return lambda number: env.step(rows[number % _DRAWN])


def step_torchrl(env: Any, actions: Actions) -> Step:
    """Step as TorchRL's collectors do; one environment behind its wrapper has no axis of environments."""
    import torch

    torch.set_num_threads(1)
    drawn = torch.as_tensor(actions if env.batch_size else actions[:, 0])
    tensors = [env.reset()]

    def step(number: int) -> None:
        tensors[0]["robot", "action"] = drawn[number % _DRAWN]
        tensors[0] = env.step_and_maybe_reset(tensors[0])[1]

    return step


def step_parallel(env: Any, actions: Actions) -> Step:
    agents = [f"robot_{robot}" for robot in range(ROBOTS)]
    drawn = [dict(zip(agents, joint[0].tolist(), strict=True)) for joint in actions]
    env.reset()

    def step(number: int) -> None:
        truncated = env.step(drawn[number % _DRAWN])[3]
        if all(truncated.values()):
            env.reset()

    return step


FACES = (
    Face(
        "`robosim.vector_env`, the floor",
        "robosim",
        """\
import robosim

env = robosim.vector_env("paper", robots=4, num_envs=16)""",
        step_batch,
    ),
    Face(
        "Gymnasium, `make_vec`",
        "gymnasium",
        """\
import gymnasium, robosim

env = gymnasium.make_vec("robosim/ExcavationTeam-v0", num_envs=64, robots=4)  # 16 teams of 4""",
        step_rows,
    ),
    Face(
        "stable-baselines3, `VecEnv`",
        "stable_baselines3",
        """\
from robosim.envs.stable_baselines import ExcavationVecEnv

env = ExcavationVecEnv("paper", robots=4, num_envs=16)""",
        step_rows,
    ),
    Face(
        "TorchRL, `EnvBase`",
        "torchrl",
        """\
from robosim.learning.faces.torchrl import ExcavationTorchEnv

env = ExcavationTorchEnv("paper", robots=4, num_envs=16)""",
        step_torchrl,
    ),
    Face(
        "BenchMARL, task",
        "benchmarl",
        """\
from robosim.learning.faces.benchmarl import ExcavationTask

env = ExcavationTask("paper", robots=4).get_env_fun(16, False, 0, "cpu")()  # as its Experiment does""",
        step_torchrl,
    ),
    Face(
        "PettingZoo, one environment",
        "pettingzoo",
        """\
import robosim

env = robosim.parallel_env("paper", robots=4)""",
        step_parallel,
        num_envs=1,
    ),
    Face(
        "TorchRL's `PettingZooWrapper`, one environment",
        "torchrl",
        """\
import robosim
from torchrl.envs import PettingZooWrapper

env = PettingZooWrapper(robosim.parallel_env("paper", robots=4), categorical_actions=True)""",
        step_torchrl,
        num_envs=1,
    ),
    Face(
        "RLlib, `MultiAgentEnv`, one environment",
        "ray",
        """\
import robosim
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

env = ParallelPettingZooEnv(robosim.parallel_env("paper", robots=4))""",
        step_parallel,
        num_envs=1,
    ),
)


@dataclass
class Measured:
    face: Face
    speeds: dict[str, float] = field(default_factory=dict)
    """By world, joint decisions for a second of the processor."""


def measure(faces: Sequence[Face], seconds: float, rounds: int) -> list[Measured]:
    """Measure all faces in turn, so that whatever changes on the machine meets all of them."""
    found = [Measured(face) for face in faces]
    for world in WORLDS:
        steps = [face.stepping(face.make(world), draw(face.num_envs)) for face in faces]
        for _ in range(rounds):
            for one, step in zip(found, steps, strict=True):
                speed = speed_of(step, seconds) * one.face.num_envs
                one.speeds[world] = max(one.speeds.get(world, 0.0), speed)
    return found


def draw(num_envs: int) -> Actions:
    return np.random.default_rng(0).integers(0, 5, (_DRAWN, num_envs, ROBOTS))


def speed_of(step: Step, seconds: float) -> float:
    """Return steps for a second of the processor; the first few are not counted."""
    for number in range(3):
        step(number)
    number, began = 0, time.process_time()
    while (took := time.process_time() - began) < seconds or not number:
        step(number)
        number += 1
    return number / took


def table(found: Sequence[Measured]) -> Iterator[str]:
    """Yield the table in Markdown."""
    yield (
        "| client | lines | " + " | ".join(f"{world}: decisions/s | of the floor" for world in WORLDS) + " |"
    )
    yield "|---" * (2 + 2 * len(WORLDS)) + "|"
    for one in found:
        cells = [one.face.client, str(one.face.lines)]
        for world in WORLDS:
            cells += [f"{one.speeds[world]:,.0f}", f"{one.speeds[world] / found[0].speeds[world]:.0%}"]
        yield f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="Lines and speed of the faces that other libraries use.")
    parser.add_argument("--seconds", type=float, default=2.0, help="of the processor, for each measurement")
    parser.add_argument("--rounds", type=int, default=3, help="measurements, of which the best counts")
    given = parser.parse_args()
    there = [face for face in FACES if importlib.util.find_spec(face.needs)]
    for line in table(measure(there, given.seconds, given.rounds)):
        print(line, flush=True)
    if missing := {face.needs: None for face in FACES if face not in there}:
        print(f"\nNot installed here: {', '.join(missing)}.")


if __name__ == "__main__":
    main()
