"""The face for stable-baselines3: every robot of every environment as a row of one policy's batch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from robosim.arena.model import Arena
from robosim.envs.config import EnvConfig
from robosim.envs.render import Painter, checked_render_mode
from robosim.envs.seeding import fresh_seed, require_fields
from robosim.envs.spaces import robot_spaces
from robosim.envs.vector import actions_in_rows, env_seeds
from robosim.envs.workers import WorkerVectorEnv, vector_env
from robosim.errors import InputError

Indices = None | int | Iterable[int]
Infos = list[dict[str, Any]]


class ExcavationVecEnv(VecEnv):
    """Robots that share a policy, as a stable-baselines3 `VecEnv` of `robots * num_envs` rows.

    The rows are the robots of one environment one after another. `arena`, `num_envs`, `workers` and `fields`
    are those of `robosim.vector_env`. All episodes end together, by truncation, and the next ones begin at
    once. An info has the pellets that the robot has `delivered` in the episode so far; where one ends also
    `TimeLimit.truncated` and `terminal_observation`. Without a seed, by `seed` or by an algorithm's own, the
    episodes are those of fresh seeds. With `workers` above 1, call close(). Wrong input raises InputError.
    """

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        num_envs: int = 1,
        workers: int = 1,
        render_mode: str | None = None,
        **fields: Any,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, {"render_modes": ["rgb_array"]})
        require_fields(fields, seeded_by="seed(...), or to the algorithm")
        self._batch = vector_env(arena, num_envs=num_envs, workers=workers, **fields)
        self._painter = Painter(self._batch.arena)
        self._actions = np.zeros((self._batch.num_envs, self._batch.robots), dtype=np.int64)
        self._begun = False
        super().__init__(num_envs * self._batch.robots, *robot_spaces(self._batch.layout))

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode in every environment; returns the observations [rows, size].

        After `seed` the first of those seeds; otherwise the next ones.
        """
        # One seed a row is given; an environment takes that of its first robot.
        seeds = self._seeds[:: self._batch.robots]
        if not self._begun or any(seed is not None for seed in seeds):
            chosen = (fresh_seed() if seed is None else seed for seed in seeds)
            # As a single environment, of any face, begins with that seed.
            observation = self._batch.reset([env_seeds(seed, 1)[0] for seed in chosen])
        else:
            observation = self._batch.reset()
        self._begun = True
        self._reset_seeds()
        self._reset_options()
        return self._rows(observation)

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Take the actions [rows] of the decision that `step_wait` carries out."""
        self._actions = actions_in_rows(actions, self.num_envs).reshape(self._actions.shape)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], Infos]:
        """Take one decision in every environment."""
        transition = self._batch.step(self._actions)
        infos: Infos = [{"delivered": count} for count in transition.final_delivered.reshape(-1).tolist()]
        ended = bool(transition.truncated[0])
        if ended:
            for info, seen in zip(infos, self._rows(transition.final_observation), strict=True):
                info |= {"TimeLimit.truncated": True, "terminal_observation": seen}
        done = np.full(self.num_envs, ended)
        return self._rows(transition.observation), self._rows(transition.reward), done, infos

    def close(self) -> None:
        """End the processes that the environments run in, if there are any."""
        if isinstance(self._batch, WorkerVectorEnv):
            self._batch.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture [height, width, 3] of each environment, not of each row."""
        return [self._painter.draw(self._batch.frame(env)) for env in range(self._batch.num_envs)]

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the batch, once for each row asked for: rows have none of their own."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the batch, which is that of all rows."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raise InputError: the rows are robots, and have no methods."""
        raise InputError(f"{method_name}: the rows are robots of a batch, and have no methods to be called.")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Return False for each row asked for: there are no single environments that could be wrapped."""
        return [False for _ in self._get_indices(indices)]

    def _rows(self, array: NDArray[Any]) -> NDArray[Any]:
        return array.reshape(self.num_envs, *array.shape[2:])
