"""One stage of learning: robots act side by side in a batch of environments, and learn from it."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor, Future
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.discretise.observation import mask_blocked_moves
from robosim.envs.vector import Transition
from robosim.learning.config import TrainConfig
from robosim.learning.curriculum import Stage
from robosim.learning.dqn import StackedDoubleDQN
from robosim.learning.metrics import Metrics, MetricsLog
from robosim.learning.networks import ActionValues, NetworkShape, Parameters
from robosim.learning.returns import Experience, MultiStepReturns
from robosim.learning.technique import find_technique

ROW = 500
"""Joint decisions in a row of the metrics."""

Weights = Mapping[str, NDArray[np.float32]]
"""Named as in a policy folder: `layer0.weight` [robots, in, out], `layer0.bias` [robots, out] and so on."""


class Environment(Protocol):
    """What the loop needs of a batch of environments; VectorEnv has it."""

    num_envs: int
    robots: int

    def reset(self) -> NDArray[np.float32]: ...
    def step(self, actions: NDArray[np.int64]) -> Transition: ...


def as_one_robot(array: NDArray[Any]) -> NDArray[Any]:
    """Return [envs, robots, ...] as [envs * robots, 1, ...]: one network takes robots for environments."""
    return np.ascontiguousarray(array).reshape(-1, 1, *array.shape[2:])


class FrozenTeam:
    """Robots that act by what they have learned, without exploration, and learn no more."""

    def __init__(
        self, shape: NetworkShape, weights: Weights, progress: tuple[int, int] | None = None
    ) -> None:
        """`shape` says how many robots there are; `weights` are theirs, `progress` as in `DqnSettings`."""
        self.robots = shape.robots
        self._progress = progress
        parameters = Parameters(shape)
        parameters.load(weights)
        self._values = ActionValues(parameters)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return actions [envs, robots] for `observation` [envs, robots, size]."""
        values = mask_blocked_moves(self._values(observation), observation, self._progress)
        return np.asarray(values.argmax(axis=2), dtype=np.int64)


class StageLoop:
    """A stage under way: environments, learner, frozen robots and the experience still open.

    The robots that learn come after the frozen ones.
    """

    def __init__(
        self,
        config: TrainConfig,
        stage: Stage,
        budget: int,
        env: Environment,
        learner: StackedDoubleDQN,
        frozen: FrozenTeam | None,
        log: MetricsLog,
    ) -> None:
        """`budget` is how many joint decisions the stage may take; rows of the metrics go to `log`."""
        self.config = config
        self.stage = stage
        self.budget = budget
        self.env = env
        self.learner = learner
        self.log = log
        self.step = 0
        """Joint decisions taken in the stage."""
        self._frozen = frozen
        self._first = 0 if frozen is None else frozen.robots
        self._shares = find_technique(config.technique).parameter_sharing
        self._returns = MultiStepReturns(config.return_steps, config.discount)
        self._observation = env.reset()

    @property
    def finished(self) -> bool:
        """Whether the budget is used up."""
        return self.step >= self.budget

    @property
    def epsilon(self) -> float:
        """Share of random actions in the environment that explores most."""
        return (
            self.config.epsilon(self.step / self.budget) if self.stage.explores else self.config.epsilon_end
        )

    @property
    def learning_rate(self) -> float:
        """Adam's step size."""
        return self.config.learning_rate_at(self.step / self.budget)

    def advance(self, beside: Executor | None = None) -> Metrics | None:
        """Take one decision in every environment, and make the updates that are due.

        Returns the row of the metrics that it closes, if any. Updates learn from what was there before
        the decision, so they can run at the same time: with `beside` the environments step in there,
        and the result is the same to the last bit.
        """
        env, learner, observation, first = self.env, self.learner, self._observation, self._first
        actions = np.empty((env.num_envs, env.robots), dtype=np.int64)
        if self._frozen is not None:
            actions[:, :first] = self._frozen.act(observation[:, :first])
        epsilons = self.config.epsilons(self.epsilon)[:, None]
        actions[:, first:] = self._explore(observation[:, first:], epsilons)
        pending: Future[Transition] | None = beside.submit(env.step, actions) if beside else None
        self._update()
        transition = pending.result() if pending else env.step(actions)
        self._remember(observation, actions, transition)
        rows_before, self.step = self.step // ROW, self.step + env.num_envs
        if self.step // ROW == rows_before and not self.finished:
            return None
        stage, loss = self.stage, float(learner.loss().mean())
        return self.log.cut(stage.name, stage.robots, stage.learning, self.epsilon, self.learning_rate, loss)

    def _explore(self, observation: NDArray[np.float32], epsilons: NDArray[np.float64]) -> NDArray[np.int64]:
        if not self._shares:
            return self.learner.act(observation, epsilons)
        envs, robots = observation.shape[:2]
        each = np.repeat(epsilons, robots, axis=0)
        return self.learner.act(as_one_robot(observation), each).reshape(envs, robots)

    def _update(self) -> None:
        config = self.config
        due = int(max(0, self.step - config.warmup) * config.updates_per_step)
        if not self.learner.replay.length:
            return
        while self.learner.updates < due:
            self.learner.update(self.learning_rate)

    def _remember(
        self, observation: NDArray[np.float32], actions: NDArray[np.int64], transition: Transition
    ) -> None:
        own = np.s_[:, self._first :]
        reward = transition.reward[own]
        decision = Experience(observation[own], actions[own], reward, transition.final_observation[own])
        complete = self._returns.add(decision, bool(transition.truncated.all()))
        if complete is not None:
            parts = [as_one_robot(part) for part in complete] if self._shares else complete
            self.learner.replay.add(*parts)
        self._observation = transition.observation
        self.log.add(
            reward,
            transition.final_delivered,
            transition.truncated,
            transition.collided,
            transition.blocked,
        )

    def state(self) -> dict[str, Tensor]:
        """Return the tensors of which the stage goes on, but for the environments' and the replay's."""
        tensors = {f"learner.{name}": tensor for name, tensor in self.learner.state().items()}
        return tensors | {f"open.{name}": torch.from_numpy(a) for name, a in self._returns.state().items()}

    def counters(self) -> dict[str, Any]:
        """Return what belongs to `state` and is no tensor, fit for JSON."""
        return {"step": self.step, "learner": self.learner.counters()}

    def restore(
        self, state: Mapping[str, Tensor], counters: Mapping[str, Any], observation: NDArray[np.float32]
    ) -> None:
        """Take back what `state` and `counters` returned, and the environments' latest observation."""
        parts: dict[str, dict[str, Tensor]] = {"learner": {}, "open": {}}
        for name, tensor in state.items():
            part, _, rest = name.partition(".")
            if part in parts:
                parts[part][rest] = tensor
        self.step = int(counters["step"])
        self.learner.restore(parts["learner"], counters["learner"])
        self._returns.restore({name: tensor.numpy() for name, tensor in parts["open"].items()})
        self._observation = observation
