"""TorchRL is no dependency of robosim; where it is not installed, there is nothing to run."""

import numpy as np
import pytest
import torch

import robosim
from robosim.errors import InputError

torchrl = pytest.importorskip(
    "torchrl", reason='TorchRL is not installed: pip install "torchrl>=0.14.1,<0.15" runs this test'
)

from torchrl.collectors import Collector  # noqa: E402
from torchrl.envs import PettingZooWrapper, check_env_specs  # noqa: E402

from robosim.learning.faces.torchrl import ExcavationTorchEnv  # noqa: E402

SHORT = {"robots": 2, "episode_steps": 6}


@pytest.mark.parametrize("num_envs", [1, 3])
def test_torchrl_finds_what_the_specs_promise(num_envs):
    check_env_specs(ExcavationTorchEnv("paper", num_envs=num_envs, **SHORT), seed=0)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_rollout_is_what_the_batch_does_to_the_bit(workers):
    env = ExcavationTorchEnv("paper", num_envs=3, workers=workers, **SHORT)
    plain = robosim.vector_env("paper", num_envs=3, **SHORT)
    try:
        env.set_seed(7)
        rollout = env.rollout(15, break_when_any_done=False)
        assert rollout.batch_size == (3, 15)
        seen = plain.reset(7)
        for step in range(15):
            now = rollout[:, step]
            assert np.array_equal(now["robot", "observation"].numpy(), seen)
            transition = plain.step(now["robot", "action"].numpy())
            seen = transition.observation
            after = now["next"]
            for name, expected in (
                ("observation", transition.final_observation),
                ("reward", transition.reward[..., None]),
                (("info", "delivered"), transition.final_delivered[..., None]),
            ):
                path = ("robot", *((name,) if isinstance(name, str) else name))
                assert np.array_equal(after[path].numpy(), expected)
            assert np.array_equal(after["truncated"].numpy()[:, 0], transition.truncated)
            assert torch.equal(after["done"], after["truncated"])
            assert not after["terminated"].any()
        assert rollout["next", "done"].sum() == 3 * 2
    finally:
        env.close()


def test_names_and_shapes_are_those_of_one_environment_behind_torchrls_own_wrapper():
    slow = PettingZooWrapper(robosim.parallel_env("paper", **SHORT))
    fast = ExcavationTorchEnv("paper", num_envs=3, **SHORT)
    assert fast.group_map == slow.group_map
    for key in (("robot", "observation"), ("robot", "action"), ("robot", "reward")):
        one, batch = (env.rollout(2).get(key, env.rollout(2)["next"].get(key)) for env in (slow, fast))
        if key[1] == "action":
            assert slow.full_action_spec[key].space.n == fast.full_action_spec[key].space.n
            continue
        assert batch.shape[2:] == one.shape[1:]
        assert batch.dtype == one.dtype


def test_torchrls_collector_fills_its_batches():
    env = ExcavationTorchEnv("paper", num_envs=4, **SHORT)
    collector = Collector(env, env.rand_action, frames_per_batch=32, total_frames=64)
    batches = list(collector)
    collector.shutdown()
    assert [batch.numel() for batch in batches] == [32, 32]
    assert batches[0]["collector", "traj_ids"].unique().numel() == 8


def test_seeds_repeat_and_fresh_ones_differ_and_wrong_use_is_a_sentence():
    first, second = (ExcavationTorchEnv("paper", num_envs=2, **SHORT) for _ in range(2))
    assert not torch.equal(first.reset()["robot", "observation"], second.reset()["robot", "observation"])
    for env in (first, second):
        env.set_seed(3)
    assert torch.equal(first.reset()["robot", "observation"], second.reset()["robot", "observation"])
    some = first.reset()
    some["_reset"] = torch.tensor([[True], [False]])
    with pytest.raises(InputError, match="reset leaves environments out, but all must begin"):
        first.reset(some)
    with pytest.raises(InputError, match=r"^seed is not an option .* give it to set_seed\(\.\.\.\)\.$"):
        ExcavationTorchEnv("paper", seed=3)
