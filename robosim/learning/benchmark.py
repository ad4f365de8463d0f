"""What an update costs: against its bare matrix products, one robot alone, and another library's learner."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np
import torch

from robosim.discretise.observation import MoveGains
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.computing import one_thread
from robosim.learning.networks import NetworkShape
from robosim.learning.precision import Precision, products_in, rounds_to_bfloat16

TEAM = NetworkShape(robots=8, inputs=90, hidden=(128, 128, 128), outputs=5)
ONE_FOR_ALL = NetworkShape(robots=1, inputs=90, hidden=(128, 128, 128), outputs=5, normalised=True)
"""What the same team learns with under `ps-dqn`."""
BATCH_SIZES = (64, 512)
TRANSITIONS = 20_000
"""Held in each robot's replay."""
TURN = 10
"""Calls that are timed at a stretch, before it is the next function's turn."""

Work = Callable[[], object]


@dataclass(frozen=True, slots=True)
class UpdateCost:
    """The cost of an update at one batch size, as processor time of the one thread that runs it."""

    robots: int
    batch_size: int
    precision: Precision
    seconds: float
    """Of an update: drawing from replay, Double-DQN target, gradient, Adam."""
    products_seconds: float
    """Of its bare matrix products, in the same precision."""
    single_seconds: float
    """Of the update of a learner with one robot."""

    @property
    def ratio(self) -> float:
        """How many times its bare products an update costs."""
        return self.seconds / self.products_seconds

    @property
    def team_share(self) -> float:
        """What the robots' update costs, as a share of as many updates of one robot."""
        return self.seconds / (self.robots * self.single_seconds)

    @property
    def robot_updates_per_second(self) -> float:
        return self.robots / self.seconds

    def as_record(self) -> dict[str, Any]:
        """Return the fields and what is derived from them, for a JSON file."""
        return {
            **dataclasses.asdict(self),
            "ratio": self.ratio,
            "team_share": self.team_share,
            "robot_updates_per_second": self.robot_updates_per_second,
        }


@dataclass(frozen=True, slots=True)
class Comparison:
    """Ours beside the DQN of stable-baselines3: same network, batch, observations and number of threads."""

    version: str
    """Of stable-baselines3."""
    batch_size: int
    robot_updates_per_second: float
    """Ours: updates a second times robots."""
    other_updates_per_second: float
    """Gradient steps a second of its one learner."""

    @property
    def ratio(self) -> float:
        """How many times as many updates a second each robot gets."""
        return self.robot_updates_per_second / self.other_updates_per_second

    def as_record(self) -> dict[str, Any]:
        """Return the fields and what is derived from them, for a JSON file."""
        return {**dataclasses.asdict(self), "ratio": self.ratio}


def measure_updates(
    updates: int, team: NetworkShape = TEAM, batch_sizes: Sequence[int] = BATCH_SIZES
) -> Iterator[UpdateCost]:
    """Yield the cost of every case: batch size, and precision where torch rounds products to it.

    `updates` is about how many are timed in each. All that is compared is timed in turns, so that
    whatever slows the machine slows all of it.
    """
    alone = dataclasses.replace(team, robots=1)
    for batch_size in batch_sizes:
        rounds = all(rounds_to_bfloat16(shape, batch_size) for shape in (team, alone))
        precisions: tuple[Precision, ...] = ("float32", "bfloat16") if rounds else ("float32",)
        work: list[Work] = []
        for precision in precisions:
            work.append(full_update(team, batch_size, precision))
            work.append(bare_products(team, batch_size, precision))
            work.append(full_update(alone, batch_size, precision))
        seconds = time_in_turns(work, updates)
        for case, precision in enumerate(precisions):
            yield UpdateCost(team.robots, batch_size, precision, *seconds[3 * case : 3 * case + 3])


def measure_one_for_all(
    updates: int, network: NetworkShape = ONE_FOR_ALL, batch_size: int = TEAM.robots * BATCH_SIZES[0]
) -> UpdateCost:
    """Return the cost of an update of `ps-dqn`: one network, normalised, with blocked moves masked."""
    update = full_update(network, batch_size, gains=MoveGains(0, 4, 4))
    seconds, products = time_in_turns([update, bare_products(network, batch_size)], updates)
    return UpdateCost(network.robots, batch_size, "float32", seconds, products, seconds)


def compare_with_stable_baselines3(
    updates: int, team: NetworkShape = TEAM, batch_size: int = BATCH_SIZES[0]
) -> Comparison | None:
    """Return our update beside that of stable-baselines3; None where it is not installed."""
    try:
        from stable_baselines3 import __version__
    except ImportError:
        return None
    work = full_update(team, batch_size), stable_baselines3_update(team, batch_size)
    ours, theirs = time_in_turns(work, updates)
    return Comparison(__version__, batch_size, team.robots / ours, 1.0 / theirs)


def time_in_turns(work: Sequence[Work], calls: int) -> list[float]:
    """Return the processor time of a call of each function: the median over turns.

    A turn's first call is not timed: it finds the caches full of what others left.
    """
    turns: list[list[float]] = [[] for _ in work]
    with one_thread():
        for _ in range(-(-calls // TURN)):
            for function, seconds in zip(work, turns, strict=True):
                function()
                began = time.thread_time()
                for _ in range(TURN):
                    function()
                seconds.append((time.thread_time() - began) / TURN)
    return [float(np.median(seconds)) for seconds in turns]


def bare_products(shape: NetworkShape, batch_size: int, precision: Precision = "float32") -> Work:
    """Return a function that makes an update's matrix products and nothing else, into reserved memory.

    The network on observations and on successors, the target network on successors, and the gradients.
    """
    products: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
    for layer, (inputs, outputs) in enumerate(shape.layers):
        x = torch.randn(shape.robots, batch_size, inputs)
        y = torch.randn(shape.robots, batch_size, outputs)
        weight = torch.randn(shape.robots, inputs, outputs)
        products += [(x, weight, torch.empty_like(y))] * 3
        products.append((x.mT, y, torch.empty_like(weight)))
        if layer:
            products.append((y, weight.mT, torch.empty_like(x)))

    def run() -> None:
        with products_in(precision), torch.inference_mode():
            for left, right, out in products:
                torch.bmm(left, right, out=out)

    return run


def full_update(
    shape: NetworkShape,
    batch_size: int,
    precision: Precision = "float32",
    gains: MoveGains | None = None,
) -> Work:
    """Return the update of a learner whose replay is filled; `gains` as in `DqnSettings`."""
    settings = DqnSettings(
        discount=0.99,
        batch_size=batch_size,
        target_interval=500,
        replay_capacity=TRANSITIONS,
        reward_scale=0.1,
        gains=gains,
    )
    learner = StackedDoubleDQN(shape, settings, np.random.SeedSequence(0), precision=precision)
    rng = np.random.default_rng(1)
    for _ in range(20):
        count = TRANSITIONS // 20
        observations, successors = rng.random((2, count, shape.robots, shape.inputs), np.float32)
        actions = rng.integers(shape.outputs, size=(count, shape.robots))
        learner.replay.add(observations, actions, rng.random(actions.shape, np.float32), successors)
    return lambda: learner.update(1e-4)


def stable_baselines3_update(shape: NetworkShape, batch_size: int) -> Work:
    """Return one gradient step of stable-baselines3's DQN on a filled replay of its own."""
    from stable_baselines3 import DQN
    from stable_baselines3.common.buffers import ReplayBuffer
    from stable_baselines3.common.logger import Logger

    learner = DQN(
        "MlpPolicy",
        _Sizes(shape.inputs, shape.outputs),
        buffer_size=TRANSITIONS,
        policy_kwargs={"net_arch": list(shape.hidden)},
        device="cpu",
        seed=0,
    )
    learner.set_logger(Logger(folder=None, output_formats=[]))
    rng = np.random.default_rng(1)
    buffer = cast(ReplayBuffer, learner.replay_buffer)
    for _ in range(TRANSITIONS):
        observation, successor = rng.random((2, 1, shape.inputs), np.float32)
        action, reward = rng.integers(shape.outputs, size=(1, 1)), rng.random(1, np.float32)
        buffer.add(observation, successor, action, reward, np.zeros(1), [{}])
    return lambda: learner.train(gradient_steps=1, batch_size=batch_size)


class _Sizes(gymnasium.Env[Any, Any]):
    """What stable-baselines3 reads the sizes of its network from; it is never stepped."""

    def __init__(self, inputs: int, outputs: int) -> None:
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (inputs,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(outputs)
