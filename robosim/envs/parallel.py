"""The PettingZoo face: all robots act at once, each with its own observation and reward."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from robosim.arena.model import Arena
from robosim.envs.actions import checked_action
from robosim.envs.config import EnvConfig
from robosim.envs.render import RENDER_MODES, checked_render_mode, render_metadata
from robosim.envs.seeding import EpisodeSeed, require_fields
from robosim.envs.spaces import robot_spaces
from robosim.envs.vector import VectorEnv
from robosim.envs.window import Screen
from robosim.errors import InputError, printable

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


class ParallelExcavation(ParallelEnv):  # type: ignore[misc]  # pettingzoo ships no types
    """A team of excavating robots as a PettingZoo ParallelEnv; agents are `robot_0`, `robot_1` ...

    `robosim.parallel_env(arena, robots=4, ...)` makes one; `arena` and `fields` are those of
    `robosim.envs.config.env_config`. Every agent acts in every step, with the number of an action; all agents
    end together, by truncation after `episode_steps` decisions. Each info has the pellets `delivered` by the
    robot so far, and the episode's `seed`; under a profile those of a reset have what was `drawn` for it,
    too. Wrong input raises InputError.
    """

    metadata: dict[str, Any] = {
        "name": "robosim_excavation_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 10 / 3,
    }

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        render_mode: str | None = None,
        **fields: Any,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata)
        require_fields(fields, seeded_by="reset(seed=...)")
        self._batch = VectorEnv(arena, num_envs=1, autoreset=False, **fields)
        self._seed = EpisodeSeed(self._batch)
        layout, robots = self._batch.layout, self._batch.robots
        self.possible_agents = [f"robot_{robot}" for robot in range(robots)]
        self.agents: list[str] = []
        spaces = {agent: robot_spaces(layout) for agent in self.possible_agents}
        self.observation_spaces = {agent: seen for agent, (seen, _) in spaces.items()}
        self.action_spaces = {agent: done for agent, (_, done) in spaces.items()}
        self.state_space = Box(np.tile(layout.low, robots), np.tile(layout.high, robots), dtype=np.float32)
        self._observation = np.zeros((robots, layout.size), dtype=np.float32)
        self.metadata = {**self.metadata, **render_metadata(self._batch.arena)}
        self._screen = Screen(self._batch, render_mode)

    def _repr_html_(self) -> str:
        return self._batch._repr_html_()

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Discrete[np.int64]:
        return self.action_spaces[self._known(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode; with a `seed` the same one every time. `options` are ignored.

        The first episode without a seed has a fresh one; the infos say which.
        """
        self._observation = self._seed.begin(seed)[0]
        self.agents = self.possible_agents[:]
        infos, drawn = self._infos(), self._batch.drawn
        if drawn is not None:
            for robot, agent in enumerate(self.possible_agents):
                infos[agent]["drawn"] = drawn[0].of_robot(robot)
        self._screen.update()
        return self._by_agent(self._observation), infos

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Take one decision; returns observations, rewards, terminations, truncations and infos by agent."""
        if not self.agents:
            raise InputError("step: no episode is under way; call reset first.")
        transition = self._batch.step(self._checked(actions)[None])
        self._observation = transition.final_observation[0]
        team = self.agents
        ended = bool(transition.truncated[0])
        if ended:
            self.agents = []
        self._screen.update()
        return (
            self._by_agent(self._observation),
            dict(zip(team, transition.reward[0].tolist(), strict=True)),
            dict.fromkeys(team, bool(transition.terminated[0])),
            dict.fromkeys(team, ended),
            self._infos(),
        )

    def state(self) -> NDArray[np.float32]:
        """Return all robots' observations in one array [robots * size], for central critics."""
        return self._observation.flatten()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture [height, width, 3] with render_mode="rgb_array", None without.

        With "human" a window shows every decision by itself, at the pace of the robots.
        """
        return self._screen.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self._screen.close()

    def _checked(self, actions: Mapping[str, int]) -> NDArray[np.int64]:
        if not isinstance(actions, Mapping):
            raise InputError(
                f"step: actions is of type {type(actions).__name__}, but must be a dict, an action an agent."
            )
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise InputError(f"step: the actions of {', '.join(missing)} are missing; every agent acts.")
        for agent in actions:
            self._known(agent)
        return np.array(
            [
                checked_action(f"step: the action of {agent}", actions[agent], self._batch.num_actions)
                for agent in self.agents
            ]
        )

    def _known(self, agent: str) -> str:
        if not isinstance(agent, str) or agent not in self.action_spaces:
            known = ", ".join(self.possible_agents)
            raise InputError(f"agent '{printable(str(agent))}' is unknown; agents are {known}.")
        return agent

    def _by_agent(self, observation: NDArray[np.float32]) -> Observations:
        return {agent: row.copy() for agent, row in zip(self.possible_agents, observation, strict=True)}

    def _infos(self) -> Infos:
        delivered = self._batch.delivered[0].tolist()
        seed = self._seed.seed
        return {
            agent: {"delivered": number, "seed": seed}
            for agent, number in zip(self.possible_agents, delivered, strict=True)
        }


parallel_env = ParallelExcavation
"""What PettingZoo's users call the constructor of a parallel environment."""
