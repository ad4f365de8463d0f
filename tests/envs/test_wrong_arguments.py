"""Wrong arguments of every face, of any kind: taken, or one printable sentence, no error from deep inside."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import robosim
from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.envs.config import EnvConfig
from robosim.envs.gym_env import ExcavationEnv
from robosim.envs.vector import VectorEnv
from robosim.episodes.trajectory import load_trajectory
from robosim.errors import InputError

ARENA = load_arena("paper")
STRANGE: list[Any] = [
    5, -1, True, 1.5, float("nan"), float("inf"), 10**400, "", "a\0b", "x" * 5000, b"x", [], [1], {}, {1: 2},
    object(), np.zeros(3), np.array(3), np.float32(1), "\x1b[31m", "\ud800", complex(1), type,
]  # fmt: skip


def taken_or_refused(call: Callable[..., Any], *args: Any, **options: Any) -> None:
    try:
        call(*args, **options)
    except InputError as refused:
        sentence = str(refused)
        assert sentence.replace("\n", "").isprintable()
        assert len(sentence) <= 1000


@pytest.mark.parametrize("field", [*EnvConfig.options(), "pheromone", "reward", "profile", "autoreset"])
def test_fields(field: str) -> None:
    for value in STRANGE:
        taken_or_refused(VectorEnv, ARENA, **{field: value})


@pytest.mark.parametrize("field", ["arena", "num_envs", "seed", "workers"])
def test_arguments_of_a_batch(field: str) -> None:
    base = () if field == "arena" else (ARENA,)
    for value in STRANGE:
        taken_or_refused(robosim.vector_env, *base, **{field: value})


@pytest.mark.parametrize("field", ["others", "render_mode", "arena"])
def test_arguments_of_the_other_faces(field: str) -> None:
    base = () if field == "arena" else (ARENA,)
    for value in STRANGE:
        taken_or_refused(ExcavationEnv, *base, **{field: value})
        if field != "others":
            taken_or_refused(robosim.parallel_env, *base, **{field: value})


def test_arguments_of_what_an_environment_does() -> None:
    env, team = VectorEnv(ARENA, robots=2), robosim.parallel_env(ARENA, robots=2)
    one = ExcavationEnv(ARENA, robots=2)
    for value in STRANGE:
        env.reset(0)
        team.reset(seed=0)
        one.reset(seed=0)
        for call in (
            env.step, env.frame, env.trajectory, env.restore, env.reset, team.step, team.observation_space,
            team.reset, one.step, load_arena, load_trajectory, make_controller, robosim.load_policy,
        ):  # fmt: skip
            taken_or_refused(call, value)
        taken_or_refused(one.reset, seed=value)


@pytest.mark.parametrize("episodes", [0, -1, 2**31, float("inf"), float("nan"), "3", None, True])
def test_an_evaluation_of_so_many_episodes_is_not_begun(episodes: Any) -> None:
    env = VectorEnv(ARENA, robots=1, episode_steps=1)
    with pytest.raises(InputError, match="but must be a whole number from 1 to 10000"):
        evaluate(make_controller("random"), env, episodes)


def test_observations_that_take_more_memory_than_there_should_be_are_not_reserved() -> None:
    with pytest.raises(
        InputError, match=r"^num_envs is 1024, but must be at most \d+ with 4 robots and \d+ numb"
    ):
        VectorEnv(ARENA, num_envs=1024, pheromone_radius=200)


class Held:
    """A face whose step waits, as long as another thread tries."""

    def __init__(self) -> None:
        self.env = VectorEnv(ARENA, robots=1)
        self.env.reset()
        self.inside, self.go_on = threading.Event(), threading.Event()
        world_step = self.env.world.step

        def waiting_step(*args: Any) -> None:
            self.inside.set()
            self.go_on.wait(10.0)
            world_step(*args)

        self.env.world.step = waiting_step  # type: ignore[method-assign]


def test_an_environment_is_stepped_by_one_thread_at_a_time() -> None:
    held = Held()
    thread = threading.Thread(target=held.env.step, args=([[0]],))
    thread.start()
    held.inside.wait(10.0)
    for what, call in (("step", lambda: held.env.step([[0]])), ("reset", held.env.reset)):
        with pytest.raises(InputError, match=f"^{what}: another thread is stepping this environment"):
            call()
    held.go_on.set()
    thread.join()
    held.env.step([[0]])
    assert held.env.steps_taken == 2
