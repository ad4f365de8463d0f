"""A toy task with the face of VectorEnv: each robot walks a corridor to and fro."""

from types import SimpleNamespace

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.envs.vector import Transition
from robosim.learning.computing import one_thread

LENGTH = 6


class Corridor:
    """Robots fetch at the east end (reward 1) and deliver at the west end (reward 1), as often as they can.

    Cells 0 to LENGTH - 1; action 3 walks east, 2 west, the others stand still. Nobody blocks anybody,
    so the best is one delivery in 2 * (LENGTH - 1) decisions for each robot.
    """

    num_actions = 5

    def __init__(self, robots=2, num_envs=1, episode_steps=100, seed=0):
        self.robots, self.num_envs, self.episode_steps = robots, num_envs, episode_steps
        self.joint_decisions = num_envs
        self.arena = load_arena("paper")
        names = (*(f"cell {i}" for i in range(LENGTH)), "laden")
        self.layout = SimpleNamespace(
            names=names, size=len(names), encoding="expanded", stigmergy=True, actions="cardinal", kinds=()
        )
        self._rng = np.random.default_rng(seed)

    def reset(self, seed=None):
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        shape = (self.num_envs, self.robots)
        self._cell = self._rng.integers(LENGTH, size=shape)
        self._laden = np.zeros(shape, bool)
        self.delivered = np.zeros(shape, np.int64)
        self._step = 0
        return self._observe()

    def step(self, actions):
        assert actions.shape == (self.num_envs, self.robots)
        assert actions.dtype == np.int64
        self._cell = np.clip(self._cell + (actions == 3) - (actions == 2), 0, LENGTH - 1)
        picked = (self._cell == LENGTH - 1) & ~self._laden
        dropped = (self._cell == 0) & self._laden
        self._laden = (self._laden | picked) & ~dropped
        self.delivered = self.delivered + dropped
        self._step += 1
        final, delivered = self._observe(), self.delivered
        ended = self._step == self.episode_steps
        observation = self.reset() if ended else final
        reward = (picked | dropped).astype(np.float32)
        never = np.zeros(self.num_envs, bool)
        nobody = np.zeros((self.num_envs, self.robots), bool)
        ends = np.full(self.num_envs, ended)
        return Transition(observation, reward, never, ends, final, delivered, nobody, nobody)

    def _observe(self):
        cells = np.eye(LENGTH, dtype=np.float32)[self._cell]
        return np.concatenate((cells, self._laden[..., None].astype(np.float32)), axis=-1)


@pytest.fixture
def corridor():
    return Corridor


@pytest.fixture(autouse=True)
def threads():
    """Torch computes with one thread, as it does in a run."""
    with one_thread():
        yield
