import pytest

from robosim.control.network import NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.dqn.config import DqnConfig


def test_exploration_falls_over_the_first_tenth_and_stays():
    config = DqnConfig()
    assert config.epsilon(0.0) == 1.0
    assert config.epsilon(0.05) == pytest.approx(0.51)
    assert config.epsilon(0.1) == pytest.approx(0.02)
    assert config.epsilon(0.999) == pytest.approx(0.02)
    assert DqnConfig(exploration=0.0).epsilon(0.0) == pytest.approx(0.02)


def test_further_environments_explore_less():
    config = DqnConfig(epsilon_spread=2.0)
    assert config.epsilons(1.0, 3) == pytest.approx([1.0, 1.0, 1.0])
    assert config.epsilons(0.02, 3) == pytest.approx([0.02, 0.02**2, 0.02**3])
    assert config.epsilons(0.02, 1) == pytest.approx([0.02])
    assert DqnConfig(epsilon_spread=0.0).epsilons(0.02, 8) == pytest.approx([0.02] * 8)


def test_step_size_falls_in_a_line_to_its_share():
    config = DqnConfig(learning_rate=1e-3, learning_rate_end=0.1)
    assert config.learning_rate_at(0.0) == pytest.approx(1e-3)
    assert config.learning_rate_at(0.5) == pytest.approx(5.5e-4)
    assert config.learning_rate_at(1.0) == config.learning_rate_at(2.0) == pytest.approx(1e-4)


def test_it_starts_from_networks_of_its_own_kind_and_takes_over_their_layers_and_mask():
    spec = NetworkSpec(inputs=4, hidden=(8,), normalisation="rms", mask=True, of_robot=(0, 1))
    config = DqnConfig(hidden=(8,)).starting_from(spec)
    assert (config.normalisation, config.mask) == ("rms", True)
    for wrong, sentence in (
        ({"output": "logits"}, "has networks from own observations to logits by relu, but must have ones"),
        ({"hidden": (9,)}, r"has hidden layers \[9\], but must have \[8\], as hidden says."),
    ):
        with pytest.raises(InputError, match=sentence):
            DqnConfig(hidden=(8,)).starting_from(spec.changed(**wrong))
    with pytest.raises(InputError, match="has a network for each robot, but must have one for all"):
        DqnConfig(hidden=(8,), parameters="shared").starting_from(spec)
    with pytest.raises(InputError) as caught:
        DqnConfig(hidden=(8,)).starting_from(spec.changed(normalisation="layer"))
    assert str(caught.value) == (
        'has layers with normalisation "layer", but must have "none" or "rms" for the algorithm "dqn".'
    )
