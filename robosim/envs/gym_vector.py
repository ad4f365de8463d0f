"""The batched Gymnasium face: learners' robots of many environments as the rows of one batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from robosim.arena.model import Arena
from robosim.control.controller import Controller
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.gym_env import driver_of
from robosim.envs.render import Painter, checked_render_mode
from robosim.envs.seeding import fresh_seed, require_fields
from robosim.envs.spaces import robot_spaces
from robosim.envs.vector import MAX_ENVS, VectorEnv, actions_in_rows, checked_actions, env_seeds, plain_seed
from robosim.envs.workers import WorkerVectorEnv, vector_env
from robosim.errors import InputError, refused, whole_number

Observations = NDArray[np.float32]
Infos = dict[str, Any]


class ExcavationVectorEnv(gymnasium.vector.VectorEnv[Observations, NDArray[np.int64], NDArray[Any]]):
    """What `gymnasium.make_vec` makes: observations [rows, size], actions [rows], stepped together.

    Of `robosim/Excavation-v0` a row is an environment whose first robot is yours and whose others a
    controller drives, as in `ExcavationEnv`. Of `robosim/ExcavationTeam-v0`, with `others` None, the rows
    are all robots of all environments, those of one environment one after another, for a policy that they
    share: `num_envs`, the number of rows, must be a multiple of `robots`.

    `arena` and `fields` are those of `robosim.envs.config.env_config`; the reward is `local` where others
    are driven. Episodes end by truncation, all at once. The next one begins, by `autoreset_mode`, in the same
    step, with what the step led to in the infos (`SAME_STEP`, the default), or in the next one, whose actions
    count for nothing (`NEXT_STEP`, as Gymnasium's own do by default). Infos are arrays [rows]: pellets
    `delivered` by the robot and by its team (`team_delivered`) so far, and the `seed` of its environment.
    Where `others` is None, `workers` above 1 shares the environments out to processes; call close() then.
    Wrong input raises InputError.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        num_envs: int = 1,
        others: str | Path | Controller | None = "lanes",
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        workers: int = 1,
        render_mode: str | None = None,
        **fields: Any,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata)
        require_fields(fields, seeded_by="reset(seed=...)")
        mode = _checked_mode(autoreset_mode)
        self._others = None if others is None else driver_of(others)
        self.num_envs = whole_number("num_envs", num_envs, 1, MAX_ENVS)
        self._batch = _batch(arena, self.num_envs, workers, self._others is None, fields)
        batch = self._batch
        self._own = slice(None) if self._others is None else slice(1)
        self.single_observation_space, self.single_action_space = robot_spaces(batch.layout)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        period = batch.arena.timing.decision_period
        self.metadata = {**self.metadata, "autoreset_mode": mode, "render_fps": 1.0 / period}
        self._seeds: tuple[int, ...] = ()
        """[envs] of Gymnasium: each gives the episodes that it gives a single environment."""
        self._observation = np.zeros((batch.num_envs, batch.robots, batch.layout.size), dtype=np.float32)
        """[envs, robots, size] of the decision that is due."""
        self._ended = False
        """Whether the next step begins an episode."""
        self._painter = Painter(batch.arena)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode in every environment; with a `seed` the same ones every time.

        One number gives the environments seeds that follow each other, as Gymnasium's own do; a list has one
        for each. Without, the next episodes of the seeds before begin, at first those of fresh seeds.
        InputError for a `reset_mask` among the `options` that leaves some out: all begin together.
        """
        self._require_open()
        mask = None if options is None else options.get("reset_mask")
        if mask is not None and not np.all(mask):
            raise InputError("reset_mask leaves environments out, but all must begin: they end together.")
        if self._ended and seed is None:
            # They have begun already.
            self._ended = False
            return self._seen(), self._infos(begun=True)
        if seed is not None or not self._seeds:
            seeds = _seeds(seed, self._batch.num_envs)
            own = self._batch.seeds_from([env_seeds(one, 1)[0] for one in seeds])
            self._observation = self._batch.reset(own)
            self._seeds = tuple(map(int, seeds))
        else:
            self._observation = self._batch.reset()
        super().reset(seed=seed if isinstance(seed, int) else None)
        self._ended = False
        self._begin()
        return self._seen(), self._infos(begun=True)

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Take one decision in every environment; `actions` is [rows]."""
        self._require_open()
        if not self._seeds:
            raise InputError("step: no episode is under way; call reset first.")
        nothing = np.zeros(self.num_envs, dtype=np.bool_)
        if self._ended:
            self._ended = False
            return self._seen(), np.zeros(self.num_envs), nothing, nothing.copy(), self._infos(begun=True)
        transition = self._batch.step(self._joint(actions))
        ended = bool(transition.truncated[0])
        self._observation = transition.observation
        seen, infos = self._seen(), self._counts(transition.final_delivered)
        if ended:
            self._begin()
            final = self._rows(transition.final_observation)
            if self.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
                infos = {
                    **_masked({"final_obs": _each(final), "final_info": infos}),
                    **self._infos(begun=True),
                }
            else:
                seen, self._ended = final, True
        reward = self._rows(transition.reward).astype(np.float64)
        return seen, reward, nothing, np.full(self.num_envs, ended), infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture [height, width, 3] of each environment with render_mode="rgb_array", None without.

        After the end of an episode they show the beginning of the next.
        """
        self._require_open()
        if self.render_mode is None:
            return None
        if not self._seeds:
            raise InputError("render: no episode has begun; call reset first.")
        return tuple(self._painter.draw(self._batch.frame(env)) for env in range(self._batch.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """End the processes that the environments run in, if there are any."""
        if isinstance(self._batch, WorkerVectorEnv):
            self._batch.close()

    def _require_open(self) -> None:
        if self.closed:
            raise InputError("the environments are closed; make new ones.")

    def _begin(self) -> None:
        if self._others is not None and isinstance(self._batch, VectorEnv):
            self._others.reset(self._batch)

    def _joint(self, actions: ArrayLike) -> NDArray[np.int64]:
        """Return the actions [envs, robots] of all robots, for those [rows] of the learners'."""
        own = actions_in_rows(actions, self.num_envs).reshape(self._batch.num_envs, -1)
        own = checked_actions(own, own.shape, self._batch.num_actions)
        if self._others is None or not isinstance(self._batch, VectorEnv):
            return own
        joint = self._others.act(self._batch, self._observation)
        joint[:, self._own] = own
        return joint

    def _rows(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return what an array [envs, robots, ...] holds of the learners' robots, as a copy [rows, ...]."""
        own = array[:, self._own]
        return own.reshape(self.num_envs, *own.shape[2:]).copy()

    def _seen(self) -> Observations:
        return self._rows(self._observation)

    def _infos(self, begun: bool = False) -> Infos:
        infos = self._counts(self._batch.delivered)
        drawn = self._batch.drawn if begun else None
        if drawn is not None:
            robots = range(*self._own.indices(self._batch.robots))
            tables = [one.of_robot(robot) for one in drawn for robot in robots]
            stacked = {name: np.array([table[name] for table in tables]) for name in tables[0]}
            infos |= _masked({"drawn": _masked(stacked)})
        return infos

    def _counts(self, delivered: NDArray[np.int64]) -> Infos:
        """Return the infos of a decision after which robots have delivered so much, [envs, robots]."""
        of_team = np.broadcast_to(delivered.sum(axis=1, keepdims=True), delivered.shape)
        seeds = np.broadcast_to(np.array(self._seeds, np.uint64)[:, None], delivered.shape)
        counts = {"delivered": delivered, "team_delivered": of_team, "seed": seeds}
        return _masked({name: self._rows(values) for name, values in counts.items()})


def _batch(
    arena: EnvConfig | Arena | str | Path | None,
    rows: int,
    workers: int,
    whole_teams: bool,
    fields: Mapping[str, Any],
) -> VectorEnv | WorkerVectorEnv:
    """Return as many environments as there are rows, or as many as have that many robots."""
    if not whole_teams:
        if workers != 1:
            raise refused(
                "workers", workers, "1 where a controller drives the others: it looks into the world"
            )
        own = {} if isinstance(arena, EnvConfig) else {"reward": "local"}
        return VectorEnv(arena, num_envs=rows, **{**own, **fields})
    robots = env_config(arena, **fields)[0].robots
    if rows % robots:
        raise refused(
            "num_envs", rows, f"a multiple of robots, {robots}: the rows are the robots of whole teams"
        )
    return vector_env(arena, num_envs=rows // robots, workers=workers, **fields)


def _seeds(seed: int | Sequence[int] | None, num_envs: int) -> Sequence[int]:
    if seed is None:
        return [fresh_seed() for _ in range(num_envs)]
    seed = plain_seed(seed)
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        return [int(seed) + env for env in range(num_envs)]
    if not isinstance(seed, (list, tuple, range, np.ndarray)):
        raise refused("seed", seed, "a whole number, or a list of one for each environment")
    return seed


def _checked_mode(mode: object) -> AutoresetMode:
    known = {one.value: one for one in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)}
    name = mode.value if isinstance(mode, AutoresetMode) else mode
    if not isinstance(name, str) or name not in known:
        raise refused("autoreset_mode", name, " or ".join(f'"{one}"' for one in known))
    return known[name]


def _each(final: Observations) -> NDArray[np.object_]:
    """Return observations as an array of arrays, which is how Gymnasium hands over the last ones."""
    parts = np.empty(len(final), dtype=object)
    parts[:] = list(final)
    return parts


def _masked(infos: Infos) -> Infos:
    """Return infos that all rows have, with the masks `_NAME` that say so."""
    masked: Infos = {}
    for name, value in infos.items():
        first = value
        while isinstance(first, dict):
            first = next(iter(first.values()))
        masked[name], masked[f"_{name}"] = value, np.ones(len(first), dtype=np.bool_)
    return masked
