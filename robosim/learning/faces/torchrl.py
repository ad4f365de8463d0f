"""The batched TorchRL face: tensors [envs, robots, ...] in a tensordict of batch size [envs]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from robosim.arena.model import Arena
from robosim.envs.config import EnvConfig
from robosim.envs.seeding import fresh_seed, require_fields
from robosim.envs.workers import WorkerVectorEnv, vector_env
from robosim.errors import InputError

GROUP = "robot"
"""Of all robots, as `PettingZooWrapper` calls the group of robot_0, robot_1 ..."""


class ExcavationTorchEnv(EnvBase):  # type: ignore[misc]  # torchrl ships no types
    """A batch of environments as a TorchRL `EnvBase` of batch size [envs].

    Under `robot` lie `observation` [envs, robots, size], `action` [envs, robots], the number of one, `reward`
    [envs, robots, 1] and ("info", "delivered") [envs, robots, 1], the pellets that the robot has delivered in
    the episode so far; `done`, `terminated` and `truncated` [envs, 1] lie at the root. Episodes end by
    truncation, all at once, and begin together. `arena`, `num_envs`, `workers` and `fields` are those of
    `robosim.vector_env`. Without `set_seed` the episodes are those of a fresh seed. Wrong input raises
    InputError, and so does a reset of some environments alone.
    """

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        num_envs: int = 1,
        workers: int = 1,
        device: torch.device | str = "cpu",
        **fields: Any,
    ) -> None:
        require_fields(fields, seeded_by="set_seed(...)")
        self._batch = vector_env(arena, num_envs=num_envs, workers=workers, autoreset=False, **fields)
        super().__init__(device=device, batch_size=torch.Size((num_envs,)))
        batch = self._batch
        self.group_map = {GROUP: [f"{GROUP}_{robot}" for robot in range(batch.robots)]}
        self._seed_due: int | None = fresh_seed()
        """Of the next reset; None where the next episode of the present seed begins."""
        self._make_specs()

    @property
    def robots(self) -> int:
        """Size of the team."""
        return self._batch.robots

    @property
    def episode_steps(self) -> int:
        """Decisions in an episode."""
        return self._batch.episode_steps

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the processes that the environments run in, if there are any."""
        if isinstance(self._batch, WorkerVectorEnv):
            self._batch.close()
        super().close(raise_if_closed=raise_if_closed)

    def _make_specs(self) -> None:
        batch, device = self._batch, self.device
        team = (batch.num_envs, batch.robots)
        size = batch.layout.size

        def of_team(**specs: Any) -> Composite:
            return Composite(
                {GROUP: Composite(specs, shape=team, device=device)}, shape=team[:1], device=device
            )

        low, high = (
            torch.as_tensor(bound, dtype=torch.float32, device=device).expand(*team, size).clone()
            for bound in (batch.layout.low, batch.layout.high)
        )
        delivered = Unbounded(shape=(*team, 1), dtype=torch.int64, device=device)
        self.observation_spec = of_team(
            observation=Bounded(low, high, shape=(*team, size), dtype=torch.float32, device=device),
            info=Composite({"delivered": delivered}, shape=team, device=device),
        )
        self.action_spec = of_team(
            action=Categorical(batch.num_actions, shape=team, dtype=torch.int64, device=device)
        )
        self.reward_spec = of_team(reward=Unbounded(shape=(*team, 1), dtype=torch.float32, device=device))
        self.done_spec = Composite(
            {
                name: Categorical(2, shape=(batch.num_envs, 1), dtype=torch.bool, device=device)
                for name in ("done", "terminated", "truncated")
            },
            shape=team[:1],
            device=device,
        )

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        if asked is not None and not bool(asked.all()):
            raise InputError("reset leaves environments out, but all must begin: they end together.")
        observation, self._seed_due = self._batch.reset(self._seed_due), None
        ended = np.zeros(self._batch.num_envs, dtype=np.bool_)
        return self._outcome(observation, self._batch.delivered, ended, ended)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        transition = self._batch.step(tensordict.get((GROUP, "action")).cpu().numpy())
        outcome = self._outcome(
            transition.final_observation,
            transition.final_delivered,
            transition.terminated,
            transition.truncated,
        )
        outcome[GROUP, "reward"] = self._tensor(transition.reward)[..., None]
        return outcome

    def _outcome(
        self,
        observation: NDArray[np.float32],
        delivered: NDArray[np.int64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> TensorDictBase:
        team = (self._batch.num_envs, self._batch.robots)
        info = TensorDict({"delivered": self._tensor(delivered)[..., None]}, batch_size=team)
        group = TensorDict({"observation": self._tensor(observation), "info": info}, batch_size=team)
        ends = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        return TensorDict(
            {GROUP: group, **{name: self._tensor(ended)[:, None] for name, ended in ends.items()}},
            batch_size=team[:1],
            device=self.device,
        )

    def _set_seed(self, seed: int | None) -> None:
        self._seed_due = fresh_seed() if seed is None else seed

    def _tensor(self, array: NDArray[Any]) -> torch.Tensor:
        # A copy: what a batch returns may be a view of what its next step writes.
        return torch.tensor(array, device=self.device)
