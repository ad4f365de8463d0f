import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import robosim
from robosim.envs.gym_env import ExcavationEnv
from robosim.envs.gym_vector import ExcavationVectorEnv
from robosim.envs.vector import env_seeds
from robosim.errors import InputError

SHORT = {"robots": 2, "episode_steps": 12}


def equal(one, two):
    """Whether two infos, tables of tables and arrays, hold the same."""
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(equal(one[name], two[name]) for name in one)
    if object in (one.dtype, two.dtype):
        return all((a is None and b is None) or np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    return np.array_equal(one, two)


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.parametrize("others", ["active", "paper-2"])
def test_it_is_what_gymnasium_makes_of_single_environments_but_faster(mode, others):
    profile = "robotarium" if others == "active" else None
    made = {**SHORT, "others": others, "profile": profile}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batch = gymnasium.make_vec("robosim/Excavation-v0", num_envs=3, autoreset_mode=mode, **made)
    assert isinstance(batch, ExcavationVectorEnv)
    slow = SyncVectorEnv([lambda: ExcavationEnv(**made)] * 3, autoreset_mode=mode)
    assert batch.metadata["autoreset_mode"] is mode
    for name in ("observation_space", "action_space", "single_observation_space", "single_action_space"):
        assert getattr(batch, name) == getattr(slow, name)
    (seen, infos), (expected, its_infos) = batch.reset(seed=5), slow.reset(seed=5)
    batch.action_space.seed(0)
    for _ in range(30):
        assert np.array_equal(seen, expected)
        assert seen in batch.observation_space
        assert equal(infos, its_infos)
        actions = batch.action_space.sample()
        seen, *outcome, infos = batch.step(actions)
        expected, *its_outcome, its_infos = slow.step(actions)
        for mine, reference in zip(outcome, its_outcome, strict=True):
            assert mine.dtype == reference.dtype
            assert np.array_equal(mine, reference)
    again, _ = batch.reset(seed=[5, 6, 7])
    assert np.array_equal(again, slow.reset(seed=5)[0])


@pytest.mark.parametrize("workers", [1, 2])
def test_the_rows_of_a_team_are_its_robots_to_the_bit(workers):
    env = gymnasium.make_vec(
        "robosim/ExcavationTeam-v0", num_envs=6, workers=workers, reward="global", **SHORT
    )
    plain = robosim.vector_env("paper", num_envs=3, reward="global", **SHORT)
    try:
        seen, infos = env.reset(seed=[1, 2, 3])
        for number, seed in enumerate((1, 2, 3)):
            observations, _ = robosim.parallel_env("paper", **SHORT).reset(seed=seed)
            assert np.array_equal(seen[2 * number : 2 * number + 2], np.stack(list(observations.values())))
        assert np.array_equal(seen, plain.reset([env_seeds(seed, 1)[0] for seed in (1, 2, 3)]).reshape(6, -1))
        assert infos["seed"].tolist() == [1, 1, 2, 2, 3, 3]
        rng = np.random.default_rng(0)
        for _ in range(25):
            actions = rng.integers(0, 5, 6)
            transition = plain.step(actions.reshape(3, 2))
            seen, reward, terminated, truncated, infos = env.step(actions)
            assert np.array_equal(seen, transition.observation.reshape(6, -1))
            assert np.array_equal(reward, transition.reward.reshape(6))
            assert not terminated.any()
            assert (truncated == transition.truncated[0]).all()
            assert np.array_equal(infos["delivered"], plain.delivered.reshape(6))
            if truncated.any():
                assert np.array_equal(
                    np.stack(infos["final_obs"]), transition.final_observation.reshape(6, -1)
                )
                final = transition.final_delivered
                assert np.array_equal(infos["final_info"]["team_delivered"], final.sum(axis=1).repeat(2))
    finally:
        env.close()
    with pytest.raises(InputError, match="the environments are closed; make new ones"):
        env.reset()


def test_gymnasiums_wrappers_and_pictures_work():
    env = gymnasium.make_vec("robosim/ExcavationTeam-v0", num_envs=4, render_mode="rgb_array", **SHORT)
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
    env.reset(seed=0)
    returns = np.zeros(4)
    for _ in range(12):
        *_, infos = (_, reward, *_) = env.step(np.array([0, 1, 2, 3]))
        returns += reward
    np.testing.assert_allclose(infos["episode"]["r"], returns)
    assert infos["episode"]["l"].tolist() == [12] * 4
    pictures = env.render()
    assert len(pictures) == 2
    assert not np.array_equal(*pictures)
    single = gymnasium.make("robosim/Excavation-v0", render_mode="rgb_array", **SHORT)
    single.reset(seed=0)
    assert pictures[0].shape == single.render().shape
    assert ExcavationVectorEnv(**SHORT).render() is None


def test_without_a_seed_episodes_differ_and_go_on():
    one, two = (ExcavationVectorEnv(num_envs=2, **SHORT) for _ in range(2))
    first = one.reset()[0]
    assert not np.array_equal(first, two.reset()[0])
    assert not np.array_equal(first, one.reset()[0])
    seeds = one.reset()[1]["seed"]
    assert seeds[0] != seeds[1]
    again = ExcavationVectorEnv(num_envs=2, **SHORT)
    assert np.array_equal(again.reset(seed=seeds.tolist())[0], first)
    # Small and large ones together, too, which numpy by itself would make floats of.
    assert again.reset(seed=[5, 2**64 - 1])[1]["seed"].tolist() == [5, 2**64 - 1]


def test_a_reset_where_the_next_episode_is_due_begins_that_one():
    env, straight = (ExcavationVectorEnv(num_envs=2, autoreset_mode="NextStep", **SHORT) for _ in range(2))
    for one in (env, straight):
        one.reset(seed=0)
        for _ in range(12):
            *_, truncated, _ = one.step(np.zeros(2, dtype=int))
        assert truncated.all()
    seen, reward, *_ = straight.step(np.zeros(2, dtype=int))
    assert not reward.any()
    assert np.array_equal(env.reset()[0], seen)


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        ({"others": None, "num_envs": 5}, "num_envs is 5, but must be a multiple of robots, 2: the rows"),
        ({"workers": 2}, "workers is 2, but must be 1 where a controller drives the others"),
        ({"others": 3}, "others is 3, but must be a name, a path or a controller"),
        ({"autoreset_mode": "Disabled"}, 'autoreset_mode is "Disabled", but must be "SameStep" or "Next'),
        ({"num_envs": 0}, "num_envs is 0, but must be a whole number from 1 to 4096"),
        ({"render_mode": "ansi"}, "render_mode is "),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_a_sentence(made, sentence):
    with pytest.raises(InputError, match=sentence):
        ExcavationVectorEnv(**{**SHORT, **made})


def test_wrong_use_is_a_sentence():
    env = ExcavationVectorEnv(num_envs=2, **SHORT)
    with pytest.raises(InputError, match="step: no episode is under way; call reset first"):
        env.step(np.zeros(2, dtype=int))
    with pytest.raises(InputError, match="reset_mask leaves environments out, but all must begin"):
        env.reset(options={"reset_mask": np.array([True, False])})
    for seed, sentence in (
        ("1", 'seed is "1", but must be a whole number, or a list of one for each environment'),
        ([1], "seed has 1 numbers, but must be one, or one for each of 2 envs"),
        (-1, "seed is -1, but must be a whole number from 0"),
    ):
        with pytest.raises(InputError, match=sentence):
            env.reset(seed=seed)
    env.reset(seed=0, options={"reset_mask": np.array([True, True])})
    for actions, sentence in (
        ([0, 0, 0], r"actions has the shape \[3\], but must be \[2\]"),
        ([0.0, 1.5], "actions is of type float64"),
        ([0, 5], "actions holds 5"),
    ):
        with pytest.raises(InputError, match=sentence):
            env.step(actions)
