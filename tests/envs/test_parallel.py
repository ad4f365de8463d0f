import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import robosim
from robosim.envs.parallel import ParallelExcavation
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError


@pytest.fixture
def env() -> ParallelExcavation:
    return robosim.parallel_env("paper", robots=2, episode_steps=5)


def stop_all(env: ParallelExcavation) -> dict[str, int]:
    return dict.fromkeys(env.agents, 4)


@pytest.mark.parametrize("actions", ["cardinal", "wheels"])
def test_keeps_pettingzoos_contract_without_a_warning(actions: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(robosim.parallel_env("paper", robots=3, episode_steps=60, actions=actions), 100)


def test_the_same_seed_gives_the_same_episode() -> None:
    parallel_seed_test(lambda: robosim.parallel_env("paper", robots=3, episode_steps=60), 100)


@pytest.mark.parametrize("encoding", ["paper", "expanded"])
@pytest.mark.parametrize("stigmergy", [True, False])
def test_every_observation_lies_in_its_space(encoding: str, stigmergy: bool) -> None:
    env = robosim.parallel_env("paper", robots=4, encoding=encoding, stigmergy=stigmergy, episode_steps=200)
    rng = np.random.default_rng(0)
    observations, _ = env.reset(seed=1)
    while env.agents:
        for agent, observation in observations.items():
            assert env.observation_space(agent).contains(observation)
        assert env.state_space.contains(env.state())
        observations, *_ = env.step({agent: int(rng.integers(5)) for agent in env.agents})


def test_gives_the_numbers_of_the_batched_environment() -> None:
    env = robosim.parallel_env("paper", robots=3, episode_steps=40)
    batch = VectorEnv("paper", robots=3, num_envs=1, episode_steps=40)
    rng = np.random.default_rng(0)
    observations, _ = env.reset(seed=7)
    expected = batch.reset(7)
    for _ in range(40):
        assert np.array_equal(np.stack(list(observations.values())), expected[0])
        assert np.array_equal(env.state(), expected[0].ravel())
        actions = rng.integers(5, size=3)
        observations, rewards, terminated, truncated, infos = env.step(
            dict(zip(env.agents, actions, strict=True))
        )
        transition = batch.step(actions[None])
        expected = transition.final_observation
        assert list(rewards.values()) == transition.reward[0].tolist()
        assert [info["delivered"] for info in infos.values()] == transition.final_delivered[0].tolist()
        assert not any(terminated.values())
        assert set(truncated.values()) == {bool(transition.truncated[0])}
    assert np.array_equal(np.stack(list(observations.values())), expected[0])


def test_observations_are_not_overwritten_by_later_steps(env: ParallelExcavation) -> None:
    first, _ = env.reset(seed=0)
    kept = {agent: observation.copy() for agent, observation in first.items()}
    env.step(dict.fromkeys(env.agents, 0))
    assert all(np.array_equal(first[agent], kept[agent]) for agent in kept)


def test_all_agents_leave_at_the_end_and_come_back_at_reset(env: ParallelExcavation) -> None:
    env.reset(seed=0)
    for _ in range(5):
        assert env.agents == ["robot_0", "robot_1"]
        truncated = env.step(stop_all(env))[3]
    assert truncated == {"robot_0": True, "robot_1": True}
    assert env.agents == []
    env.reset()
    assert env.agents == ["robot_0", "robot_1"]


def test_a_step_outside_an_episode_is_refused(env: ParallelExcavation) -> None:
    sentence = r"^step: no episode is under way; call reset first\.$"
    with pytest.raises(InputError, match=sentence):
        env.step({"robot_0": 4, "robot_1": 4})
    env.reset(seed=0)
    for _ in range(5):
        env.step(stop_all(env))
    with pytest.raises(InputError, match=sentence):
        env.step({"robot_0": 4, "robot_1": 4})


@pytest.mark.parametrize(
    ("actions", "sentence"),
    [
        ({"robot_0": 4}, "step: the actions of robot_1 are missing; every agent acts."),
        ({}, "step: the actions of robot_0, robot_1 are missing; every agent acts."),
        (
            {"robot_0": 4, "robot_1": 4, "robot_2": 4},
            "agent 'robot_2' is unknown; agents are robot_0, robot_1.",
        ),
        ([4, 4], "step: actions is of type list, but must be a dict, an action an agent."),
        (
            {"robot_0": 4, "robot_1": float("nan")},
            "step: the action of robot_1 is nan, but must be a whole number from 0 to 4.",
        ),
        (
            {"robot_0": 5, "robot_1": 0},
            "step: the action of robot_0 is 5, but must be a whole number from 0 to 4.",
        ),
    ],
)
def test_wrong_actions_are_one_sentence(env: ParallelExcavation, actions: object, sentence: str) -> None:
    env.reset(seed=0)
    with pytest.raises(InputError) as caught:
        env.step(actions)  # type: ignore[arg-type]
    assert str(caught.value) == sentence


def test_a_refused_step_changes_nothing() -> None:
    env, twin = (robosim.parallel_env("paper", robots=2) for _ in range(2))
    env.reset(seed=3)
    twin.reset(seed=3)
    with pytest.raises(InputError):
        env.step({"robot_0": 0, "robot_1": 9})
    actions = {"robot_0": 3, "robot_1": 2}
    assert np.array_equal(env.step(actions)[0]["robot_0"], twin.step(actions)[0]["robot_0"])


def test_unknown_agents_have_no_spaces(env: ParallelExcavation) -> None:
    with pytest.raises(InputError, match=r"^agent 'robot_9' is unknown; agents are robot_0, robot_1\.$"):
        env.action_space("robot_9")
    with pytest.raises(InputError, match="robot_9"):
        env.observation_space("robot_9")


def test_unknown_render_mode_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        robosim.parallel_env("paper", robots=2, render_mode="ansi")
    assert str(caught.value) == 'render_mode is "ansi", but must be None or "human" or "rgb_array".'


def test_renders_the_last_moment_of_an_episode_too() -> None:
    env = robosim.parallel_env("paper", robots=2, episode_steps=3, render_mode="rgb_array")
    with pytest.raises(InputError, match=r"^render: no episode has begun; call reset first\.$"):
        env.render()
    env.reset(seed=0)
    first = env.render()
    while env.agents:
        env.step(dict.fromkeys(env.agents, 3))
    last = env.render()
    assert first is not None
    assert last is not None
    assert first.shape == last.shape
    assert not np.array_equal(first, last)


def test_without_a_render_mode_nothing_is_drawn(env: ParallelExcavation) -> None:
    env.reset(seed=0)
    assert env.render() is None
