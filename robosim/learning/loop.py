"""One stage of learning: robots act side by side in a batch of environments, and learn from it."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor, Future
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from robosim.envs.vector import Transition
from robosim.learning.actors import FrozenTeam
from robosim.learning.algorithms.protocol import Algorithm, Experience, State
from robosim.learning.curriculum import Stage
from robosim.learning.metrics import Metrics, MetricsLog

ROW = 500
"""Joint decisions in a row of the metrics."""


class Environment(Protocol):
    """What the loop needs of a batch of environments; VectorEnv and MixedVectorEnv have it."""

    num_envs: int
    """First axis of all arrays."""
    robots: int
    """Second axis."""

    @property
    def joint_decisions(self) -> int:
        """Environments that take a decision in a step, which need not be the first axis."""
        ...

    def reset(self) -> NDArray[np.float32]: ...
    def step(self, actions: NDArray[np.int64]) -> Transition: ...


class StageLoop:
    """A stage under way: environments, algorithm and frozen robots.

    The robots that learn come after the frozen ones.
    """

    def __init__(
        self,
        stage: Stage,
        budget: int,
        env: Environment,
        algorithm: Algorithm,
        frozen: FrozenTeam | None,
        log: MetricsLog,
    ) -> None:
        """`budget` is how many joint decisions the stage may take; rows of the metrics go to `log`."""
        self.stage = stage
        self.budget = budget
        self.env = env
        self.algorithm = algorithm
        self.log = log
        self.step = 0
        """Joint decisions taken in the stage."""
        self._frozen = frozen
        self._first = 0 if frozen is None else frozen.robots
        self._observation = env.reset()

    @property
    def finished(self) -> bool:
        """Whether the budget is used up."""
        return self.step >= self.budget

    @property
    def progress(self) -> float:
        """Share of the budget that is used up."""
        return self.step / self.budget

    def advance(self, beside: Executor | None = None) -> Metrics | None:
        """Take one decision in every environment, and make the updates that are due.

        Returns the row of the metrics that it closes, if any. Updates learn from what was there before
        the decision, so they can run at the same time: with `beside` the environments step in there,
        and the result is the same to the last bit.
        """
        env, observation, first, progress = self.env, self._observation, self._first, self.progress
        actions = np.empty((env.num_envs, env.robots), dtype=np.int64)
        if self._frozen is not None:
            actions[:, :first] = self._frozen.act(observation[:, :first])
        actions[:, first:] = self.algorithm.act(observation[:, first:], progress)
        pending: Future[Transition] | None = beside.submit(env.step, actions) if beside else None
        self.log.note(self.algorithm.update(progress))
        transition = pending.result() if pending else env.step(actions)
        self._observe(observation, actions, transition)
        rows_before, self.step = self.step // ROW, self.step + env.joint_decisions
        if self.step // ROW == rows_before and not self.finished:
            return None
        return self.log.cut(self.stage.name, self.stage.robots, self.stage.learning)

    def _observe(
        self, observation: NDArray[np.float32], actions: NDArray[np.int64], transition: Transition
    ) -> None:
        own = np.s_[:, self._first :]
        experience = Experience(
            observation[own],
            actions[own],
            transition.reward[own],
            transition.final_observation[own],
            transition.observation[own],
            transition.terminated,
            transition.truncated,
        )
        self.algorithm.observe(experience)
        self._observation = transition.observation
        self.log.add(
            experience.reward,
            transition.final_delivered,
            experience.ended,
            transition.collided,
            transition.blocked,
            self.env.joint_decisions,
        )

    def state(self) -> State:
        """Return that of which the stage goes on, without environments and large memories."""
        tensors, facts = self.algorithm.state()
        named = {f"algorithm.{name}": tensor for name, tensor in tensors.items()}
        return State(named, {"step": self.step, "algorithm": facts})

    def restore(
        self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any], observation: NDArray[np.float32]
    ) -> None:
        """Take back what `state` returned, and the environments' latest observation."""
        prefix = "algorithm."
        own = {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}
        self.step = int(facts["step"])
        self.algorithm.restore(State(own, facts["algorithm"]))
        self._observation = observation
