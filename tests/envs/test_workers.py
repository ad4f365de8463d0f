import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import robosim
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.envs.vector import VectorEnv
from robosim.envs.workers import WorkerVectorEnv, vector_env
from robosim.errors import InputError


@pytest.fixture(scope="module")
def split() -> Iterator[WorkerVectorEnv]:
    env = vector_env("paper", robots=2, num_envs=5, workers=2, episode_steps=30)
    assert isinstance(env, WorkerVectorEnv)
    yield env
    env.close()


def test_one_worker_is_the_plain_environment() -> None:
    assert isinstance(vector_env("paper", robots=2), VectorEnv)


@pytest.mark.parametrize("seed", [3, [11, 12, 13, 14, 15]])
def test_workers_change_no_bit(split: WorkerVectorEnv, seed: int | list[int]) -> None:
    whole = VectorEnv("paper", robots=2, num_envs=5, episode_steps=30)
    rng = np.random.default_rng(0)
    assert np.array_equal(split.reset(seed), whole.reset(seed))
    for _ in range(70):  # two ends of episodes within
        actions = rng.integers(5, size=(5, 2))
        for ours, theirs in zip(split.step(actions), whole.step(actions), strict=True):
            assert ours.dtype == theirs.dtype
            assert np.array_equal(ours, theirs)
        assert np.array_equal(split.delivered, whole.delivered)
    assert np.array_equal(split.reset(), whole.reset())


def test_has_the_attributes_of_the_plain_environment(split: WorkerVectorEnv) -> None:
    whole = VectorEnv("paper", robots=2, num_envs=5, episode_steps=30)
    for name in ("num_envs", "robots", "num_actions", "episode_steps", "layout"):
        assert getattr(split, name) == getattr(whole, name)
    assert split.arena.name == "paper"


@pytest.mark.parametrize("env", [0, 2, 4])
def test_frames_come_from_the_right_worker(split: WorkerVectorEnv, env: int) -> None:
    whole = VectorEnv("paper", robots=2, num_envs=5, episode_steps=30)
    split.reset(9)
    whole.reset(9)
    actions = np.full((5, 2), 3)
    for _ in range(10):
        split.step(actions)
        whole.step(actions)
    ours, theirs = split.frame(env), whole.frame(env)
    assert np.array_equal(ours.pose, theirs.pose)
    assert np.array_equal(ours.pellets, theirs.pellets)
    assert np.array_equal(ours.contacts.impulse, theirs.contacts.impulse)
    assert np.array_equal(ours.contacts.env, theirs.contacts.env)


def test_transitions_are_not_overwritten_by_later_steps(split: WorkerVectorEnv) -> None:
    split.reset(0)
    first = split.step(np.zeros((5, 2), dtype=int))
    kept = first.observation.copy()
    split.step(np.ones((5, 2), dtype=int))
    assert np.array_equal(first.observation, kept)


@pytest.mark.parametrize(
    "actions", [np.zeros((5, 3), dtype=int), np.full((5, 2), 5), np.zeros((5, 2)), np.full((5, 2), np.nan)]
)
def test_wrong_actions_are_the_same_sentence(split: WorkerVectorEnv, actions: np.ndarray) -> None:
    whole = VectorEnv("paper", robots=2, num_envs=5)
    whole.reset(0)
    split.reset(0)
    with pytest.raises(InputError) as expected:
        whole.step(actions)
    with pytest.raises(InputError) as caught:
        split.step(actions)
    assert str(caught.value) == str(expected.value)


def test_a_worker_finds_the_error_and_goes_on() -> None:
    with vector_env("paper", robots=1, num_envs=2, workers=2) as env:
        with pytest.raises(InputError, match=r"^step: no episode has begun; call reset first\.$"):
            env.step(np.zeros((2, 1), dtype=int))
        env.reset(0)
        assert env.step(np.zeros((2, 1), dtype=int)).reward.shape == (2, 1)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"workers": 0}, "workers is 0, but must be a whole number from 1 to num_envs, 4."),
        ({"workers": 5}, "workers is 5, but must be a whole number from 1 to num_envs, 4."),
        ({"workers": 2.0}, "workers is 2.0, but must be a whole number from 1 to num_envs, 4."),
        ({"workers": True}, "workers is true, but must be a whole number from 1 to num_envs, 4."),
    ],
)
def test_wrong_worker_counts_are_one_sentence(wrong: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        vector_env("paper", robots=2, num_envs=4, **wrong)  # type: ignore[arg-type]
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    "wrong", [{"robots": 0}, {"robots": 2, "encoding": "plain"}, {"robots": 2, "seed": -1}]
)
def test_other_wrong_options_are_the_plain_environments_sentence(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError) as expected:
        vector_env("paper", num_envs=4, **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError) as caught:
        vector_env("paper", num_envs=4, workers=2, **wrong)  # type: ignore[arg-type]
    assert str(caught.value) == str(expected.value)


def workers_alive() -> set[int]:
    return {child.pid or 0 for child in multiprocessing.active_children()}


def test_close_leaves_no_process_behind() -> None:
    before = workers_alive()
    env = vector_env("paper", robots=1, num_envs=2, workers=2)
    assert isinstance(env, WorkerVectorEnv)
    assert len(workers_alive() - before) == 2
    env.close()
    env.close()
    assert workers_alive() == before
    with pytest.raises(InputError, match="the environments are closed"):
        env.reset()


def test_a_forgotten_environment_leaves_no_process_behind() -> None:
    before = workers_alive()
    env = vector_env("paper", robots=1, num_envs=2, workers=2)
    del env
    gc.collect()
    assert workers_alive() == before


def test_a_killed_worker_is_reported_and_the_other_one_ended() -> None:
    before = workers_alive()
    env = vector_env("paper", robots=1, num_envs=2, workers=2)
    env.reset(0)
    os.kill((workers_alive() - before).pop(), signal.SIGKILL)
    with pytest.raises(RuntimeError, match=r"^worker \d of 2 ended unexpectedly, exit code -9\.$"):
        env.reset(0)
    assert workers_alive() == before


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        textwrap.dedent("""
        import os, signal, robosim
        if __name__ == "__main__":
            env = robosim.vector_env("paper", robots=1, num_envs=2, workers=2)
            print("made", flush=True)
            os.kill(os.getpid(), signal.SIGKILL)
        """)
    )
    # It returns only when all who hold the output have ended, the workers too; or else the time is up.
    result = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=30, check=False
    )
    assert result.returncode == -signal.SIGKILL
    assert result.stdout == "made\n"


def test_public_name() -> None:
    assert robosim.vector_env is vector_env


def test_a_moment_of_workers_is_one_of_the_plain_environment_and_back(split: WorkerVectorEnv) -> None:
    whole = VectorEnv("paper", robots=2, num_envs=5, episode_steps=30)
    rng = np.random.default_rng(2)
    split.reset(4)
    for _ in range(40):  # into the second episode
        split.step(rng.integers(5, size=(5, 2)))
    moment = split.snapshot()
    assert moment.actions.shape == (10, 5, 2)
    restored = whole.restore(moment)
    actions = rng.integers(5, size=(3, 5, 2))
    after = [whole.step(chosen).observation for chosen in actions]
    split.step(actions[0])
    assert np.array_equal(split.restore(moment), restored)
    for chosen, expected in zip(actions, after, strict=True):
        assert np.array_equal(split.step(chosen).observation, expected)
    with pytest.raises(InputError, match="this environment has"):
        split.restore(_of_another_size())


def _of_another_size():
    other = VectorEnv("paper", robots=1)
    other.reset()
    return other.snapshot()


def test_workers_keep_what_the_plain_environment_does_at_the_end_of_an_episode() -> None:
    with vector_env(
        "paper", robots=1, num_envs=2, workers=np.int64(2), episode_steps=2, autoreset=False, world="grid"
    ) as env:
        env.reset(0)
        env.step(np.zeros((2, 1), dtype=int))
        ended = env.step(np.zeros((2, 1), dtype=int))
        assert np.array_equal(ended.observation, ended.final_observation)
        with pytest.raises(InputError, match="the episode has ended after 2 decisions"):
            env.step(np.zeros((2, 1), dtype=int))


def step_for_ever(env: WorkerVectorEnv, actions: np.ndarray) -> None:
    while True:
        env.step(actions)


def test_after_an_interrupt_it_is_sound_or_says_that_it_is_closed() -> None:
    """As by Ctrl-C in a notebook, which goes on with the same object."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before, cut_short = workers_alive(), 0
    handler = signal.signal(signal.SIGALRM, interrupt)
    try:
        for delay in (0.05, 0.08):
            env = WorkerVectorEnv("paper", robots=4, num_envs=4, workers=2)
            env.reset(0)
            stop = np.full((4, 4), 4)
            signal.setitimer(signal.ITIMER_REAL, delay)
            with pytest.raises(KeyboardInterrupt):
                step_for_ever(env, stop)
            try:
                observation = env.reset(7)
            except InputError as error:
                cut_short += 1
                assert str(error) == (
                    "vector_env: a decision was interrupted, and what has become of it is not known; "
                    "the environments are closed, make new ones."
                )
                assert workers_alive() == before
                with pytest.raises(InputError, match="make new ones"):
                    env.step(stop)
            else:
                np.testing.assert_array_equal(observation, VectorEnv("paper", robots=4, num_envs=4).reset(7))
                env.close()
    finally:
        signal.signal(signal.SIGALRM, handler)
    assert cut_short


@pytest.mark.parametrize("workers", [1, 2])
def test_environments_are_closed_alike_however_many_processes_they_run_in(workers) -> None:
    with robosim.vector_env("paper", robots=2, num_envs=2, workers=workers) as env:
        assert env.reset().shape[:2] == (2, 2)
    env.close()


def test_what_an_evaluation_cannot_look_into_is_a_sentence() -> None:
    with robosim.vector_env("paper", robots=2, num_envs=2, workers=2) as env:
        with pytest.raises(InputError) as caught:
            evaluate(make_controller("paper-2"), env, 1)
        assert str(caught.value) == (
            "evaluate: looks into the world of the environments, so workers must be 1."
        )
        with pytest.raises(InputError, match='^controller is "lanes", but must be a controller, as robosim'):
            evaluate("lanes", env, 1)
