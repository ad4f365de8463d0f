import warnings

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import robosim
from robosim.envs.stable_baselines import ExcavationVecEnv
from robosim.envs.vector import VectorEnv, env_seeds
from robosim.errors import InputError

SHORT = {"robots": 2, "episode_steps": 12}


@pytest.mark.parametrize("workers", [1, 2])
def test_the_rows_are_the_robots_of_the_batch_to_the_bit(workers):
    env = ExcavationVecEnv("paper", num_envs=3, workers=workers, **SHORT)
    plain = robosim.vector_env("paper", num_envs=3, **SHORT)
    assert env.num_envs == 6
    try:
        env.seed(4)
        seen = env.reset()
        assert np.array_equal(seen, plain.reset([env_seeds(seed, 1)[0] for seed in (4, 6, 8)]).reshape(6, -1))
        rng = np.random.default_rng(0)
        ended = 0
        for _ in range(26):
            actions = rng.integers(0, 5, 6)
            transition = plain.step(actions.reshape(3, 2))
            seen, reward, done, infos = env.step(actions)
            assert np.array_equal(seen, transition.observation.reshape(6, -1))
            assert np.array_equal(reward, transition.reward.reshape(6))
            assert (done == transition.truncated[0]).all()
            assert [info["delivered"] for info in infos] == transition.final_delivered.reshape(6).tolist()
            ended += done.all()
            for info, final in zip(infos, transition.final_observation.reshape(6, -1), strict=True):
                assert ("terminal_observation" in info) == done.all()
                if done.all():
                    assert info["TimeLimit.truncated"]
                    assert np.array_equal(info["terminal_observation"], final)
        assert ended == 2
        assert np.array_equal(env.reset(), plain.reset().reshape(6, -1))
    finally:
        env.close()


def test_stable_baselines3_trains_one_policy_for_all_robots(tmp_path):
    env = VecNormalize(VecMonitor(ExcavationVecEnv("paper", num_envs=4, reward="local", **SHORT)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = PPO("MlpPolicy", env, n_steps=24, batch_size=64, n_epochs=1, seed=0, device="cpu")
        before = [parameter.detach().clone() for parameter in model.policy.parameters()]
        model.learn(2 * 24 * 8)
    after = list(model.policy.parameters())
    assert any(not np.array_equal(a.detach(), b) for a, b in zip(after, before, strict=True))
    # Monitored: what an episode of each robot came to.
    assert {episode["l"] for episode in model.ep_info_buffer} == {12}
    assert len(model.ep_info_buffer) == 4 * 8
    model.save(tmp_path / "model")
    actions, _ = PPO.load(tmp_path / "model").predict(env.reset(), deterministic=True)
    assert actions.shape == (8,)


def test_pictures_are_of_environments_and_rows_have_no_methods():
    env = ExcavationVecEnv("paper", num_envs=2, render_mode="rgb_array", **SHORT)
    env.reset()
    height, width, _ = env.get_images()[0].shape
    assert env.render().shape in {(height, 2 * width, 3), (2 * height, width, 3)}
    assert env.get_attr("render_mode", [0, 1]) == ["rgb_array"] * 2
    assert not env.has_attr("teleport")
    assert env.env_is_wrapped(VecMonitor) == [False] * 4
    with pytest.raises(InputError, match="render: the rows are robots of a batch, and have no methods"):
        env.env_method("render")
    first, second = (ExcavationVecEnv("paper", num_envs=2, **SHORT).reset() for _ in range(2))
    assert not np.array_equal(first, second)


def test_wrong_input_is_a_sentence():
    env = ExcavationVecEnv("paper", num_envs=2, **SHORT)
    with pytest.raises(InputError, match="step: no episode has begun; call reset first"):
        env.step(np.zeros(4, dtype=int))
    env.reset()
    with pytest.raises(InputError, match=r"actions has the shape \[2, 2\], but must be \[4\]"):
        env.step(np.zeros((2, 2), dtype=int))
    with pytest.raises(InputError, match="actions holds 7"):
        env.step(np.full(4, 7))


def test_a_seed_gives_the_episode_that_it_gives_every_other_face() -> None:
    env = ExcavationVecEnv("paper", robots=2)
    env.seed(5)
    rows = env.reset()
    assert rows.tolist() == VectorEnv("paper", robots=2, seed=5).reset()[0].tolist()
