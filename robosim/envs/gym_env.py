"""The Gymnasium face: one robot learns among others that follow a script or a trained policy."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.control.controller import Controller, make_controller
from robosim.envs.actions import checked_action
from robosim.envs.config import EnvConfig
from robosim.envs.render import RENDER_MODES, checked_render_mode, render_metadata
from robosim.envs.seeding import EpisodeSeed, require_fields
from robosim.envs.spaces import robot_spaces
from robosim.envs.vector import VectorEnv
from robosim.envs.window import Screen
from robosim.errors import InputError, refused

Observation = NDArray[np.float32]


class ExcavationEnv(gymnasium.Env[Observation, np.int64]):
    """`robosim/Excavation-v0`: the first robot of a team is yours, `others` drives the rest.

    `others` is the name of a scripted controller, the name or folder of a trained policy, or a
    controller. `arena` and `fields` are those of `robosim.envs.config.env_config`, but here the reward is
    `local` unless you say otherwise: what others deliver says little of one learner's own actions. Episodes
    end by truncation after `episode_steps` decisions. The info has the pellets `delivered` by your robot
    and by the team (`team_delivered`) so far, and the `seed`; under a profile that of a reset has what was
    `drawn` for your robot, too. Wrong input raises InputError.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 10 / 3}

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        others: str | Path | Controller = "lanes",
        render_mode: str | None = None,
        **fields: Any,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata)
        require_fields(fields, seeded_by="reset(seed=...)")
        if not isinstance(arena, EnvConfig):
            fields.setdefault("reward", "local")
        self._batch = VectorEnv(arena, num_envs=1, autoreset=False, **fields)
        self._seed = EpisodeSeed(self._batch)
        self._others = driver_of(others)
        layout = self._batch.layout
        self.observation_space, self.action_space = robot_spaces(layout)
        self._observation = np.zeros((1, self._batch.robots, layout.size), dtype=np.float32)
        self._under_way = False
        self.metadata = render_metadata(self._batch.arena)
        self._screen = Screen(self._batch, render_mode)

    def _repr_html_(self) -> str:
        return self._batch._repr_html_()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; with a `seed` the same one every time. `options` are ignored.

        The first episode without a seed has a fresh one; the info says which.
        """
        # First, for what it refuses is a sentence.
        self._observation = self._seed.begin(seed)
        super().reset(seed=None if seed is None else int(seed))
        self._others.reset(self._batch)
        self._under_way = True
        info, drawn = self._info(), self._batch.drawn
        if drawn is not None:
            info["drawn"] = drawn[0].of_robot(0)
        self._screen.update()
        return self._observation[0, 0].copy(), info

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take one decision: `action` for your robot, the controller's for the others."""
        if not self._under_way:
            raise InputError("step: no episode is under way; call reset first.")
        own = checked_action("step: the action", action, self._batch.num_actions)
        actions = self._others.act(self._batch, self._observation)
        actions[0, 0] = own
        transition = self._batch.step(actions)
        self._observation = transition.final_observation
        ended = bool(transition.truncated[0])
        self._under_way = not ended
        self._screen.update()
        return (
            self._observation[0, 0].copy(),
            float(transition.reward[0, 0]),
            bool(transition.terminated[0]),
            ended,
            self._info(),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture [height, width, 3] with render_mode="rgb_array", None without.

        With "human" a window shows every decision by itself, at the pace of the robots.
        """
        return self._screen.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self._screen.close()

    def _info(self) -> dict[str, Any]:
        delivered = self._batch.delivered[0]
        return {
            "delivered": int(delivered[0]),
            "team_delivered": int(delivered.sum()),
            "seed": self._seed.seed,
        }


def driver_of(others: object) -> Controller:
    """Return what drives the robots that are not the learner's: a controller, or one by its name or path.

    A controller is copied, for it remembers its environment, and may be handed to several. InputError for
    anything else.
    """
    if isinstance(others, str | Path):
        return make_controller(others)
    if not (hasattr(others, "reset") and hasattr(others, "act")):
        raise refused("others", others, "a name, a path or a controller")
    return copy.deepcopy(others)  # type: ignore[return-value]  # it has what a controller has
