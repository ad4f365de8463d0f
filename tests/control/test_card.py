import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.card import (
    StageCard,
    TechniqueCard,
    TrainingCard,
    arena_card,
    card_for,
    card_text,
    fingerprint,
    read_card,
)
from robosim.control.network import NetworkSpec
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError, shown


def test_card_survives_its_file(tmp_path, card):
    path = tmp_path / "card.json"
    path.write_text(card_text(card))
    assert read_card(path) == card


def refused(tmp_path, text):
    path = tmp_path / "card.json"
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    with pytest.raises(InputError) as caught:
        read_card(path)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("place", "value", "sentence"),
    [
        ("format_version", 1, "format_version is 1; this robosim reads version 2."),
        ("format_version", "1", 'format_version is "1", but must be 2.'),
        ("format", "other", 'format is "other", but must be "robosim-policy".'),
        ("env.robots", 0, "env.robots is 0, but must be a whole number from 1 to 1000."),
        ("env.robots", 1.5, "env.robots is 1.5, but must be a whole number from 1 to 1000."),
        ("env.robots", True, f"env.robots is {shown(True)}, but must be a whole number from 1 to 1000."),
        (
            "env.robots",
            4,
            "network.of_robot is [0, 1, 2], but must hold 4 numbers, one for each robot.",
        ),
        ("env.actions", "fly", 'env.actions is "fly", but must be "cardinal" or "wheels" or "wheels-9".'),
        ("env.arena", "/etc/passwd", 'env.arena is "/etc/passwd", but must be the text of an arena.'),
        ("env.pheromone.decay", 2, "env.pheromone.decay is 2, but must be a number from 1e-06 to 1."),
        ("arena.cell_size", 0.0, "arena.cell_size is 0.0, but must be a number above 0."),
        ("arena.cell_size", float("nan"), "not a policy card, which is a JSON object (NaN is no JSON)."),
        ("arena.robot.mass", -1.0, "arena.robot.mass is -1.0, but must be a number from 0.01 to 100."),
        (
            "network.hidden",
            [0],
            "network.hidden is 0, but must be a list of 1 to 8 whole numbers from 1 to 4096.",
        ),
        (
            "network.of_robot",
            [0, 2, 0],
            "network: of_robot is [0, 2, 0], but must name every stored network, counted from 0.",
        ),
        (
            "network.of_robot",
            [0, 1],
            "network.of_robot is [0, 1], but must hold 3 numbers, one for each robot.",
        ),
        (
            "network.precision",
            "int8",
            'network.precision is "int8", but must be "float32" or "float16".',
        ),
        ("network.inputs", 8, "network.inputs is 8, but must be the 7 numbers of an observation."),
        (
            "network.mask",
            True,
            (
                f"network.mask is {shown(True)}, but must be {shown(False)} where "
                "observations hold no gains of moves."
            ),
        ),
        (
            "evaluation.delivered",
            [[1, 2, 3], [4]],
            "evaluation: delivered must hold 3 numbers, one for each robot, in each episode.",
        ),
        (
            "evaluation.collisions",
            [4],
            "evaluation: collisions must hold 2 numbers, one for each episode.",
        ),
        (
            "evaluation.closest",
            [0.2, 0.3, 0.4],
            "evaluation: closest must hold 2 numbers, one for each episode.",
        ),
        (
            "evaluation.longest_lapse",
            [200],
            "evaluation: longest_lapse must hold 2 numbers, one for each episode.",
        ),
        (
            "evaluation.delivered",
            [[10**50, 2, 3], [4, 5, 6]],
            (
                "evaluation.delivered is a whole number of more than 30 digits, but must be a list of lists "
                "of whole numbers from 0 to 1000000000000000."
            ),
        ),
        (
            "evaluation.robots",
            10**50,
            (
                "evaluation.robots is a whole number of more than 30 digits, but must be "
                "a whole number from 1 to 1000."
            ),
        ),
        (
            "training.stages",
            [{"name": "x"}],
            "training.stages.robots is missing; it must be a whole number from 1.",
        ),
        (
            "notes",
            "x" * 2001,
            f'notes is "{"x" * 75} ..., but must be a text of at most 2000 characters.',
        ),
    ],
)
def test_wrong_field_is_one_sentence(tmp_path, card, place, value, sentence):
    data = json.loads(card_text(card))
    *outer, name = place.split(".")
    inner = data
    for step in outer:
        inner = inner[step]
    inner[name] = value
    assert refused(tmp_path, json.dumps(data)) == sentence


def test_an_unknown_field_is_one_sentence(tmp_path, card):
    data = json.loads(card_text(card))
    data["speed"] = 3
    assert refused(tmp_path, json.dumps(data)).startswith('"speed" is not an option: known names are arena, ')


def test_the_fingerprint_must_be_that_of_the_arenas_text(tmp_path, card):
    data = json.loads(card_text(card))
    data["arena"]["sha256"] = "abc"
    known = fingerprint(load_arena("paper").text)
    assert refused(tmp_path, json.dumps(data)) == (
        f'arena.sha256 is "abc", but must be the fingerprint of env.arena, "{known}".'
    )


def test_stages_reference_and_notes_survive_their_file(tmp_path, card):
    stage = StageCard(name="newcomer 3", robots=3, learning=1, steps=500, ended="steady")
    full = card.changed(
        training=card.training.changed(stages=(stage,)),
        network=card.network.changed(of_robot=(0, 1, 0), precision="float16"),
        reference=card.evaluation.changed(controller="lanes"),
        technique=card.technique.changed(facts={"algorithm": "double DQN"}),
        notes="Stands still at times.",
    )
    path = tmp_path / "card.json"
    path.write_text(card_text(full))
    assert read_card(path) == full
    assert (full.network.networks, full.share) == (2, 1.0)


def test_a_card_is_of_the_environment_that_the_team_learned_in(weights_of):
    env = VectorEnv("s-bend", robots=3, reward="local", pheromone_decay=0.2, episode_steps=77)
    spec = NetworkSpec(inputs=env.layout.size, hidden=(4,), mask=True, of_robot=(0, 0))
    weights = {name: np.zeros(shape, np.float32) for name, shape in spec.shapes.items()}
    training = TrainingCard(command="mine", seed=1, steps=10, wall_time=0.5, versions={})
    card = card_for(env, spec, weights, "mine", training, {"algorithm": "my own"})
    assert card.env == env.config.changed(robots=2)
    assert card.env.arena == load_arena("s-bend").text
    assert (card.arena.name, card.robots, card.observation) == ("s-bend", 2, env.layout.names)
    assert card.technique == TechniqueCard(name="mine", facts={"algorithm": "my own"})
    with pytest.raises(InputError) as caught:
        card_for(env, spec.changed(of_robot=(0, 1)), weights, "mine", training)
    assert str(caught.value) == ("weights: the shape of layer0.bias is [1, 4], but must be [2, 4].")


def test_share_is_relative_to_the_reference(card):
    lanes = card.evaluation.changed(delivered=((8, 8, 8), (8, 8, 8)))
    assert card.changed(reference=lanes).share == 0.25
    idle = lanes.changed(delivered=((0, 0, 0), (0, 0, 0)))
    assert card.changed(reference=idle).share is None


def test_missing_field_is_one_sentence(tmp_path, card):
    data = json.loads(card_text(card))
    del data["network"]["inputs"]
    assert refused(tmp_path, json.dumps(data)) == (
        "network.inputs is missing; it must be a whole number from 1 to 100000."
    )


@pytest.mark.parametrize("text", ["[]", "7", "null"])
def test_what_is_no_card_is_refused(tmp_path, text):
    assert refused(tmp_path, text) == "not a policy card, which is a JSON object."


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "Expecting value: line 1 column 1 (char 0)"),
        ("{", "Expecting property name enclosed in double quotes: line 1 column 2 (char 1)"),
        (b"\xff\xfe", "Expecting value: line 1 column 1 (char 0)"),
        ("[" * 100_000, "it is nested too deeply"),
    ],
)
def test_what_is_no_json_is_refused_with_the_reason(tmp_path, text, reason):
    said = refused(tmp_path, text)
    assert said.startswith(f"not a policy card, which is a JSON object ({reason}")


def test_a_huge_card_is_refused(tmp_path):
    assert (
        refused(tmp_path, " " * 5_000_001)
        == "larger than 5000000 bytes, the most that a policy card may have."
    )


def test_robots_draw_otherwise_in_place_only_where_they_observe_that_they_are(card):
    network = card.network.changed(temperature=0.5, temperature_in_place=2.0)
    with pytest.raises(InputError) as caught:
        card.changed(network=network)
    assert str(caught.value).endswith(
        "network.temperature_in_place is 2.0, but must be absent where observations do not say how long a "
        "robot has been in place."
    )
    with pytest.raises(InputError, match=r"network\.retreat_in_place is 8, but must be absent where obs"):
        card.changed(network=card.network.changed(temperature=0.5, retreat_in_place=8))


@settings(deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 6000), put=st.binary(max_size=4))
def test_no_damage_ends_in_anything_but_a_sentence(tmp_path_factory, card_of, cut, put):
    path = tmp_path_factory.mktemp("card") / "card.json"
    data = card_text(card_of()).encode()
    path.write_bytes(data[:cut] + put + data[cut + len(put) :])
    try:
        read_card(path)
    except InputError as error:
        assert "\n" not in str(error)


def test_fingerprint_is_of_the_arenas_text():
    arena = load_arena("paper")
    one = arena_card(arena)
    assert (one.name, one.cell_size, len(one.sha256)) == ("paper", arena.cell_size, 64)


def test_evaluation_figures(card):
    evaluation = card.evaluation
    assert evaluation.totals == (3, 9)
    assert (evaluation.mean, evaluation.per_robot) == (6.0, (2.0, 2.0, 2.0))
    assert evaluation.std == pytest.approx(18**0.5)
