"""TorchRL is no dependency of robosim; where it is not installed, there is nothing to run."""

import re
import subprocess
import sys

import numpy as np
import pytest

import robosim

torchrl = pytest.importorskip(
    "torchrl", reason='TorchRL is not installed: pip install "torchrl>=0.14.1,<0.15" runs this test'
)


@pytest.mark.slow
def test_torchrl_trains_from_the_command_line_and_robosim_runs_the_team(examples, tmp_path) -> None:
    script = [sys.executable, examples / "torchrl_iql.py", "--frames", "400", "--out", tmp_path / "team"]
    run = subprocess.run(script, capture_output=True, text=True, timeout=300, check=True)
    rows = re.findall(r"^frame (\d+): loss ([\d.]+), \d+ pellets", run.stdout, flags=re.MULTILINE)
    assert [frame for frame, _ in rows] == ["200", "400"]
    policy = robosim.load_policy(tmp_path / "team")
    assert (policy.card.training.steps, policy.card.network.hidden) == (400, (128, 128))
    env = robosim.vector_env("paper", robots=2, num_envs=3)
    team = robosim.make_controller(tmp_path / "team")
    team.reset(env)
    assert team.act(env, env.reset()).shape == (3, 2)


def test_the_policy_folder_says_what_torchrl_s_networks_say(examples, tmp_path) -> None:
    import torch
    from saving import save_team
    from torchrl_iql import learn, weights_of

    before, networks = (learn("paper", 2, frames=frames, seed=0) for frames in (50, 100))
    assert not any(
        np.array_equal(weights_of(before)[name], array) for name, array in weights_of(networks).items()
    )
    env = robosim.vector_env("paper", robots=2, num_envs=16)
    save_team(tmp_path / "team", weights_of(networks), env, "iql", seed=0, steps=100, wall_time=1.0)
    observation = np.random.default_rng(0).uniform(-1, 1, (100, 2, env.layout.size)).astype(np.float32)
    with torch.no_grad():
        values = networks(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(
        robosim.load_policy(tmp_path / "team").values(observation), values, rtol=1e-4, atol=1e-5
    )
