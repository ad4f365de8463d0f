"""tools/widen_policy.py: room for more in networks that compute the same."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from robosim.control.policy import load_policy
from robosim.errors import InputError
from tests.policies.made import make_policy

TOOL = Path(__file__).parent.parent.parent / "tools" / "widen_policy.py"
spec = importlib.util.spec_from_file_location("widen_policy", TOOL)
tool = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tool)


@pytest.mark.parametrize("hidden", [(8, 6), (20, 6), (8, 30), (20, 30)])
def test_wider_networks_say_the_same_and_their_new_units_can_learn(tmp_path, hidden):
    before = load_policy(make_policy(tmp_path / "narrow", 1, (8, 6), activation="tanh"))
    tool.main([str(tmp_path / "narrow"), "--hidden", *map(str, hidden), "--out", str(tmp_path / "wide")])
    wide = load_policy(tmp_path / "wide")
    assert wide.card.network == before.card.network.changed(hidden=hidden)
    observation = np.random.default_rng(2).uniform(-1, 1, (50, 2, before.card.network.inputs))
    observation = observation.astype(np.float32)
    np.testing.assert_allclose(wide.values(observation), before.values(observation), atol=1e-5)
    # What comes into a new unit is drawn as for a fresh network; nothing of it goes to an old one yet.
    narrow, weights = before.weights(), wide.weights()
    for layer in range(3):
        name = f"layer{layer}.weight"
        inputs, outputs = narrow[name].shape[1:]
        np.testing.assert_array_equal(weights[name][:, :inputs, :outputs], narrow[name])
        assert not weights[name][:, inputs:, :outputs].any()
        assert weights[name][:, :, outputs:].all()


def test_what_cannot_be_widened_is_refused_and_nothing_is_written(tmp_path):
    narrow = make_policy(tmp_path / "narrow", 1, (8, 6))
    normalised = make_policy(tmp_path / "normalised", 1, (8, 6), normalisation="rms")
    said = (
        f"{normalised}: its networks normalise hidden layers (rms), which new units change: only networks "
        "without normalisation can be widened."
    )
    for policy, hidden, sentence in (
        (narrow, (8,), "hidden is 8: there must be 2 widths, none less than 8 6."),
        (narrow, (8, 5), "hidden is 8 5: there must be 2 widths, none less than 8 6."),
        (
            normalised,
            (8, 8),
            said,
        ),
    ):
        with pytest.raises(InputError) as caught:
            tool.widen(policy, hidden, tmp_path / "wide")
        assert str(caught.value) == sentence
        assert not (tmp_path / "wide").exists()
