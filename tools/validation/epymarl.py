"""EPyMARL (Papoudakis 2021) on simple_spread, with the settings of its own files but for exploration.

It is no package: `path` is a checkout of github.com/uoe-agents/epymarl. Its learners, controllers and replay
are used as they are; episodes are filled in here, several at a time, in place of its runners, which step one
environment, or one a process. It learns once for as many episodes as its runners would have collected, and it
counts a cut-off as the end of the task.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray

from validation.spread import ACTIONS, EPISODE, ROBOTS, SIZE, Act, Spread

Options = dict[str, Any]

METHODS: dict[str, tuple[str, Options]] = {
    "ia2c": ("ia2c", {"common_reward": False}),
    "ippo": ("ippo", {"common_reward": False}),
    "mappo": ("mappo", {"common_reward": False}),
    "maddpg": ("maddpg_ns", {"common_reward": False}),
    "dqn": ("iql", {"common_reward": False}),
    "vdn": ("vdn", {"common_reward": True}),
    "qmix": ("qmix", {"common_reward": True}),
}
"""Configuration file, and options that differ from it."""
EXPLORATION = 0.1
"""Share of the decisions over which exploration falls, as in robosim. Its own files say 50,000 decisions or
more: as many as a run has here, which would explore all the time."""
SIDE_BY_SIDE = 8
"""Episodes at a time where its runner takes one."""


class _Silent:
    """Stands where its logger is asked for."""

    def log_stat(self, key: str, value: object, t: int) -> None:
        pass


def _settings(path: Path, method: str) -> Options:
    """Return the options of a method: its defaults, its own file, and ours."""
    name, options = METHODS[method]
    read = [
        yaml.safe_load((path / "src/config" / file).read_text())
        for file in ("default.yaml", f"algs/{name}.yaml")
    ]
    merged: Options = {**read[0], **read[1], **options}
    return merged | {
        "use_cuda": False,
        "n_agents": ROBOTS,
        "n_actions": ACTIONS,
        "state_shape": ROBOTS * SIZE,
    }


class _Epymarl:
    """A controller, a learner and a replay of its own, put together as its `run.py` does."""

    def __init__(self, path: Path, settings: Options) -> None:
        sys.path.insert(0, str(path / "src"))
        buffers = importlib.import_module("components.episode_buffer")
        one_hot = importlib.import_module("components.transforms").OneHot(out_dim=ACTIONS)
        self.args = SimpleNamespace(**settings, device="cpu")
        self._scheme = {
            "state": {"vshape": ROBOTS * SIZE},
            "obs": {"vshape": SIZE, "group": "agents"},
            "actions": {"vshape": (1,), "group": "agents", "dtype": torch.long},
            "avail_actions": {"vshape": (ACTIONS,), "group": "agents", "dtype": torch.int},
            "terminated": {"vshape": (1,), "dtype": torch.uint8},
            "reward": {"vshape": (1 if self.args.common_reward else ROBOTS,)},
        }
        self._kinds = ({"agents": ROBOTS}, {"actions": ("actions_onehot", [one_hot])})
        self._batch = buffers.EpisodeBatch
        groups, preprocess = self._kinds
        self.replay = buffers.ReplayBuffer(
            self._scheme, groups, self.args.buffer_size, EPISODE + 1, preprocess=preprocess
        )
        controllers = importlib.import_module("controllers").REGISTRY
        learners = importlib.import_module("learners").REGISTRY
        self.mac = controllers[self.args.mac](self.replay.scheme, groups, self.args)
        self.learner = learners[self.args.learner](self.mac, self.replay.scheme, _Silent(), self.args)

    def episodes(self, count: int) -> Any:
        """Return room for so many episodes."""
        groups, preprocess = self._kinds
        return self._batch(self._scheme, groups, count, EPISODE + 1, preprocess=preprocess)

    def see(self, batch: Any, observation: NDArray[np.float32], decision: int) -> None:
        envs = len(observation)
        seen = {
            "state": observation.reshape(envs, -1),
            "obs": observation,
            "avail_actions": np.ones((envs, ROBOTS, ACTIONS), np.int64),
        }
        batch.update({name: torch.from_numpy(one) for name, one in seen.items()}, ts=decision)

    def collect(self, spread: Spread, done: int) -> Any:
        """Return episodes of all environments; `done` decisions have been taken before."""
        batch = self.episodes(spread.num_envs)
        observation = spread.reset()
        self.mac.init_hidden(batch_size=spread.num_envs)
        for decision in range(EPISODE + 1):
            self.see(batch, observation, decision)
            with torch.no_grad():
                actions = self.mac.select_actions(batch, t_ep=decision, t_env=done, test_mode=False)
            batch.update({"actions": actions.unsqueeze(-1)}, ts=decision)
            if decision == EPISODE:
                return batch
            step = spread.step(actions.numpy())
            reward = step.reward.mean(axis=1, keepdims=True) if self.args.common_reward else step.reward
            ended = torch.full((spread.num_envs, 1), step.truncated)
            batch.update(
                {"reward": torch.from_numpy(reward), "terminated": ended}, ts=decision, mark_filled=False
            )
            observation = step.final_observation
        raise AssertionError


def learn(method: str, seed: int, decisions: int, path: Path) -> tuple[Act, list[float], Options]:
    """Return what was learned, the returns on the way, and the settings."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002  its replay draws from the global generator
    settings = _settings(path, method)
    if settings.get("action_selector") == "epsilon_greedy":
        settings["epsilon_anneal_time"] = round(EXPLORATION * decisions)
    together = settings["runner"] == "parallel"
    spread = Spread(settings["batch_size_run"] if together else SIDE_BY_SIDE, seed)
    team = _Epymarl(path, settings)
    done, episodes = 0, 0
    while done < decisions:
        team.replay.insert_episode_batch(team.collect(spread, done))
        done += spread.num_envs * EPISODE
        for _ in range(1 if together else spread.num_envs):
            episodes += spread.num_envs if together else 1
            if team.replay.can_sample(settings["batch_size"]):
                team.learner.train(team.replay.sample(settings["batch_size"]), done, episodes)
    decision = 0
    batch: Any = None

    def act(observation: NDArray[np.float32], begins: bool) -> NDArray[np.int64]:
        nonlocal decision, batch
        if begins:
            decision, batch = 0, team.episodes(len(observation))
            team.mac.init_hidden(batch_size=len(observation))
        team.see(batch, observation, decision)
        with torch.no_grad():
            outputs = team.mac.forward(batch, decision)
        decision += 1
        return np.asarray(outputs.argmax(dim=-1).numpy())

    return act, spread.returns, {"num_envs": spread.num_envs, **settings}
