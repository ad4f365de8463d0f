"""tools/average_policies.py: one policy out of several that learned from one another."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from robosim.control.policy import load_policy
from robosim.errors import InputError
from tests.policies.made import make_policy

TOOL = Path(__file__).parent.parent.parent / "tools" / "average_policies.py"
spec = importlib.util.spec_from_file_location("average_policies", TOOL)
tool = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tool)


def test_weights_are_the_mean_and_the_card_says_of_what(tmp_path, capsys):
    folders = [make_policy(tmp_path / str(seed), seed) for seed in (1, 2, 3)]
    out = tmp_path / "mean"
    assert tool.main([*map(str, folders), "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: the mean of 3 policies, 36 decisions in all\n"
    mean, given = load_policy(out), [load_policy(folder) for folder in folders]
    for key, array in mean.weights().items():
        parts = [policy.weights()[key] for policy in given]
        np.testing.assert_allclose(array, (parts[0] + parts[1] + parts[2]) / 3, rtol=1e-5, atol=1e-6)
        assert array.dtype == parts[0].dtype
    training = mean.card.training
    assert training.command.split() == [
        "python", "tools/average_policies.py", *map(str, folders), "--out", str(out),
    ]  # fmt: skip
    assert (training.seed, training.steps, training.wall_time) == (3, 36, 4.5)
    assert mean.card.network == given[0].card.network


def test_equal_policies_have_themselves_as_their_mean(tmp_path):
    folder = make_policy(tmp_path / "one", 1)
    tool.average([folder, folder], tmp_path / "mean")
    mean, before = load_policy(tmp_path / "mean").weights(), load_policy(folder).weights()
    assert all((mean[key] == array).all() for key, array in before.items())


def test_how_actions_are_drawn_may_differ_and_is_that_of_the_last(tmp_path):
    drawing = {"temperature": 0.5, "temperature_in_place": 8.0}
    drawing |= {"retreat_in_place": 8, "retreat_with_pellet": 6}
    best, draws = make_policy(tmp_path / "best", 1), make_policy(tmp_path / "draws", 1, **drawing)
    assert tool.average([best, draws], tmp_path / "mean").network == load_policy(draws).card.network
    assert tool.average([draws, best], tmp_path / "mean").network == load_policy(best).card.network


def test_what_has_no_mean_is_refused_and_nothing_is_written(tmp_path, capsys):
    one = make_policy(tmp_path / "one", 1)
    for other, what in (
        (make_policy(tmp_path / "wide", 2, hidden=(9,)), "network"),
        (make_policy(tmp_path / "dqn", 2, technique="ps-dqn"), "technique"),
    ):
        assert tool.main([str(one), str(other), "--out", str(tmp_path / "mean")]) == 2
        expected = f"{one}: its card's {what} is not that of {other}: they must be equal."
        assert expected in capsys.readouterr().err
    with pytest.raises(InputError) as caught:
        tool.average([one], tmp_path / "mean")
    assert str(caught.value) == "POLICY names one policy: an average needs two or more."
    assert not (tmp_path / "mean").exists()
