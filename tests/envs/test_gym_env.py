import warnings
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import DQN

import robosim
from robosim.control.controller import make_controller
from robosim.envs.gym_env import ExcavationEnv
from robosim.errors import InputError


def test_made_by_name_it_passes_gymnasiums_checker_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("robosim/Excavation-v0", robots=3, episode_steps=50, render_mode="rgb_array")
        # The checker makes one for each mode, and a window needs a display, as in test_window.py.
        env.unwrapped.metadata = {**env.unwrapped.metadata, "render_modes": ["rgb_array"]}
        check_env(env.unwrapped)


def test_the_same_seed_gives_the_same_episode() -> None:
    def episode() -> list[np.ndarray]:
        env = ExcavationEnv("paper", robots=3, episode_steps=60)
        rng = np.random.default_rng(0)
        observations = [env.reset(seed=5)[0]]
        ended = False
        while not ended:
            observation, reward, _, ended, _ = env.step(rng.integers(5))
            observations += [observation, np.array(reward)]
        return observations

    assert all(np.array_equal(one, two) for one, two in zip(episode(), episode(), strict=True))


def test_the_others_carry_pellets_while_the_learner_stands_still() -> None:
    env = ExcavationEnv("paper", robots=3, others="lanes", episode_steps=400)
    env.reset(seed=0)
    ended = False
    while not ended:
        *_, ended, info = env.step(np.int64(4))
    assert info["delivered"] == 0
    assert info["team_delivered"] > 0


def test_all_robots_lanes_is_what_the_controller_does_alone() -> None:
    """With the learner following the script as well, the episode is the controller's own."""
    env = ExcavationEnv("paper", robots=2, others="lanes", episode_steps=50)
    batch = robosim.vector_env("paper", robots=2, episode_steps=50, reward="local")
    controller = robosim.make_controller("lanes")
    own, _ = env.reset(seed=2)
    observation = batch.reset(2)
    controller.reset(batch)
    for _ in range(50):
        assert np.array_equal(own, observation[0, 0])
        actions = controller.act(batch, observation)
        transition = batch.step(actions)
        observation = transition.final_observation
        own, reward, *_ = env.step(actions[0, 0])
        assert reward == transition.reward[0, 0]


def test_a_controller_of_ones_own_drives_the_others() -> None:
    env = ExcavationEnv("paper", robots=2, others=robosim.make_controller("random"), episode_steps=10)
    env.reset(seed=0)
    assert env.step(np.int64(0))[0].shape == env.observation_space.shape


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Networks this small lose more by sharing out than they gain."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("one_thread")
def test_stable_baselines3_trains_on_it() -> None:
    env = gymnasium.make("robosim/Excavation-v0", arena="paper", robots=2, episode_steps=500)
    model = DQN("MlpPolicy", env, seed=0, learning_starts=200, buffer_size=3000, train_freq=8, device="cpu")
    model.learn(2000)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert env.observation_space.contains(env.step(action)[0])


def test_a_step_outside_an_episode_is_refused() -> None:
    env = ExcavationEnv("paper", robots=2, episode_steps=1)
    sentence = r"^step: no episode is under way; call reset first\.$"
    with pytest.raises(InputError, match=sentence):
        env.step(np.int64(0))
    env.reset(seed=0)
    assert env.step(np.int64(0))[3]
    with pytest.raises(InputError, match=sentence):
        env.step(np.int64(0))


def test_wrong_action_is_one_sentence() -> None:
    env = ExcavationEnv("paper", robots=2)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"^step: the action is 7, but must be a whole number from 0 to"):
        env.step(np.int64(7))
    with pytest.raises(InputError, match=r"is nan, but must be a whole number from 0 to 4\.$"):
        env.step(float("nan"))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True, 2**64])
def test_a_wrong_seed_is_one_sentence_and_the_episode_goes_on(seed: object) -> None:
    env = ExcavationEnv("paper", robots=2, world="grid")
    env.reset(seed=np.int64(4))
    with pytest.raises(InputError, match=r"^seed is .*, but must be a whole number from 0 to "):
        env.reset(seed=seed)  # type: ignore[arg-type]
    assert env.step(np.int64(0))[4]["seed"] == 4


def test_others_that_are_no_controller_are_one_sentence() -> None:
    with pytest.raises(InputError, match="^others is None, but must be a name, a path or a controller"):
        ExcavationEnv("paper", others=None)  # type: ignore[arg-type]


def test_a_controller_handed_to_several_environments_drives_each_by_itself() -> None:
    fields = {"robots": 6, "arena": "single-lane"}
    one = make_controller("lanes")
    together = gymnasium.make_vec(
        "robosim/Excavation-v0", num_envs=2, vectorization_mode="sync", others=one, **fields
    )
    alone = [ExcavationEnv(others="lanes", **fields) for _ in range(2)]
    seen, _ = together.reset(seed=5)
    own = np.stack([env.reset(seed=5 + row)[0] for row, env in enumerate(alone)])
    for _ in range(80):
        assert seen.tolist() == own.tolist()
        seen = together.step(np.array([3, 3]))[0]
        own = np.stack([env.step(np.int64(3))[0] for env in alone])
