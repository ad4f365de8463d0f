import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.errors import InputError
from robosim.learning.config import TrainConfig, read_config, write_config
from robosim.learning.technique import TECHNIQUES, Technique, find_technique


@given(
    arena=st.text(st.characters(exclude_categories=["Cs"]), max_size=30),
    learning_rate=st.floats(1e-8, 1.0),
    hidden=st.lists(st.integers(1, 4096), min_size=1, max_size=8).map(tuple),
    seed=st.integers(0, 2**63 - 1),
    overlap=st.booleans(),
)
def test_config_survives_its_file(tmp_path_factory, arena, learning_rate, hidden, seed, overlap):
    path = tmp_path_factory.mktemp("config") / "config.toml"
    config = TrainConfig(arena=arena, learning_rate=learning_rate, hidden=hidden, seed=seed, overlap=overlap)
    write_config(config, path)
    assert read_config(path) == config
    names = [line.split(" = ")[0] for line in path.read_text().splitlines()]
    assert names == [field.name for field in dataclasses.fields(TrainConfig)]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("robots = ", "not a TOML file (Invalid value (at end of document))."),
        ('robots = "two"', "robots is 'two': it must be a whole number."),
        ("robots = true", "robots is True: it must be a whole number."),
        ("robots = 0", "robots is 0: it must be a number from 1 to 1000."),
        ("discount = nan", "discount is nan: it must be a number from 0 to 0.99999."),
        ("hidden = [1.5]", "hidden is [1.5]: it must be a list of whole numbers."),
        ("hidden = []", "hidden is (): it must be 1 to 8 widths from 1 to 4096."),
        ("overlap = 1", "overlap is 1: it must be true or false."),
        ('newcomer = "clone"', "newcomer is 'clone': it must be scratch or copy."),
        (
            "pheromone_decay = 2.0",
            "decay is 2.0, but must be a number from 1e-06 to 1.",
        ),
        ("robot = 2", "unknown key 'robot': did you mean robots?"),
        ("epsilon_start = 0.01", "epsilon_end is 0.02: it must not exceed epsilon_start, 0.01."),
        ('actions = "jump"', "actions is 'jump': it must be cardinal or wheels."),
        ('technique = "iql+gss"', "unknown technique 'iql+gss': did you mean iql+gs or iql+s or iql+g?"),
    ],
)
def test_wrong_file_is_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "config.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert str(caught.value).removeprefix(f"{path}: ") == sentence


def test_missing_file_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.toml: No such file or directory\.$"):
        read_config(tmp_path / "nowhere.toml")


def test_exploration_falls_over_the_first_tenth_and_stays():
    config = TrainConfig()
    assert config.epsilon(0.0) == 1.0
    assert config.epsilon(0.05) == pytest.approx(0.51)
    assert config.epsilon(0.1) == pytest.approx(0.02)
    assert config.epsilon(0.999) == pytest.approx(0.02)
    assert TrainConfig(exploration=0.0).epsilon(0.0) == pytest.approx(0.02)


def test_further_environments_explore_less():
    config = TrainConfig(num_envs=3, epsilon_spread=2.0)
    assert config.epsilons(1.0) == pytest.approx([1.0, 1.0, 1.0])
    assert config.epsilons(0.02) == pytest.approx([0.02, 0.02**2, 0.02**3])
    assert TrainConfig(num_envs=1).epsilons(0.02) == pytest.approx([0.02])
    assert TrainConfig(epsilon_spread=0.0).epsilons(0.02) == pytest.approx([0.02] * 8)


def test_step_size_falls_in_a_line_to_its_share():
    config = TrainConfig(learning_rate=1e-3, learning_rate_end=0.1)
    assert config.learning_rate_at(0.0) == pytest.approx(1e-3)
    assert config.learning_rate_at(0.5) == pytest.approx(5.5e-4)
    assert config.learning_rate_at(1.0) == config.learning_rate_at(2.0) == pytest.approx(1e-4)


def test_techniques_add_one_thing_each():
    flags = {name: (t.global_reward, t.stigmergy, t.curriculum) for name, t in TECHNIQUES.items()}
    assert flags == {
        "iql": (False, False, False),
        "iql+g": (True, False, False),
        "iql+s": (False, True, False),
        "iql+gs": (True, True, False),
        "smadrl": (True, True, True),
        "iql+sc": (False, True, True),
        "ps-dqn": (False, True, False),
    }
    alone = [t for t in TECHNIQUES.values() if t.name != "ps-dqn"]
    assert not any(t.parameter_sharing or t.normalised or t.action_mask for t in alone)
    ours = find_technique("ps-dqn")
    assert (ours.parameter_sharing, ours.normalised, ours.action_mask) == (True, True, True)
    assert find_technique("iql").name == "iql"
    assert find_technique("iql+gsc").name == "smadrl"


def test_one_network_for_all_and_a_curriculum_exclude_each_other():
    with pytest.raises(InputError) as caught:
        Technique("x", False, True, curriculum=True, parameter_sharing=True)
    assert str(caught.value) == (
        "technique 'x': one network for all cannot be frozen beside itself, so parameter_sharing and "
        "curriculum must not both be True."
    )
