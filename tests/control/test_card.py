import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.card import StageCard, arena_card, card_text, read_card
from robosim.errors import InputError


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
        ("format_version", 2, "format_version is 2; this robosim reads version 1."),
        ("format_version", "1", "format_version: input should be 1, not '1'."),
        ("format", "other", "format: input should be 'robosim-policy', not 'other'."),
        ("robots", 0, "robots: input should be greater than or equal to 1, not '0'."),
        ("robots", 1.5, "robots: input should be a valid integer, not '1.5'."),
        ("robots", True, "robots: input should be a valid integer, not 'True'."),
        ("speed", 3, "speed: extra inputs are not permitted, not '3'."),
        ("arena.sha256", "abc", "arena.sha256: string should match pattern '^[0-9a-f]{64}$', not 'abc'."),
        ("arena.cell_size", float("nan"), "arena.cell_size: input should be a finite number, not 'nan'."),
        ("robot.mass", -1.0, "robot.mass: input should be greater than or equal to 0.01, not '-1.0'."),
        ("network.hidden", [0], "network.hidden.0: input should be greater than or equal to 1, not '0'."),
        ("actions", "fly", "actions: input should be 'cardinal' or 'wheels', not 'fly'."),
        ("network.of_robot", [0, 1], "network.of_robot must hold 3 numbers, one for each robot."),
        (
            "network.of_robot",
            [0, 2, 0],
            "network: of_robot must name every stored network, counted from 0.",
        ),
        (
            "network.precision",
            "int8",
            "network.precision: input should be 'float32' or 'float16', not 'int8'.",
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
        ("training.stages", [{"name": "x"}], "training.stages.0.robots: field required."),
        ("notes", "x" * 2001, f"notes: string should have at most 2000 characters, not {'x' * 60!r}."),
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


def test_a_card_of_before_the_zoo_still_loads(tmp_path, card):
    data = json.loads(card_text(card))
    del data["reference"], data["notes"], data["training"]["stages"]
    del data["network"]["of_robot"], data["network"]["precision"]
    path = tmp_path / "card.json"
    path.write_text(json.dumps(data))
    old = read_card(path)
    assert old == card
    assert (old.reference, old.notes, old.training.stages) == (None, "", ())
    assert (old.network.precision, old.networks, old.share) == (None, 3, None)


def test_stages_reference_and_notes_survive_their_file(tmp_path, card):
    stage = StageCard(name="newcomer 3", robots=3, learning=1, steps=500, ended="steady")
    full = card.model_copy(
        update={
            "training": card.training.model_copy(update={"stages": (stage,)}),
            "network": card.network.model_copy(update={"of_robot": (0, 1, 0), "precision": "float16"}),
            "reference": card.evaluation.model_copy(update={"controller": "lanes"}),
            "notes": "Stands still at times.",
        }
    )
    path = tmp_path / "card.json"
    path.write_text(card_text(full))
    assert read_card(path) == full
    assert (full.networks, full.share) == (2, 1.0)


def test_share_is_relative_to_the_reference(card):
    lanes = card.evaluation.model_copy(update={"delivered": ((8, 8, 8), (8, 8, 8))})
    assert card.model_copy(update={"reference": lanes}).share == 0.25
    idle = lanes.model_copy(update={"delivered": ((0, 0, 0), (0, 0, 0))})
    assert card.model_copy(update={"reference": idle}).share is None


def test_missing_field_is_one_sentence(tmp_path, card):
    data = json.loads(card_text(card))
    del data["observation"]["names"]
    assert refused(tmp_path, json.dumps(data)) == "observation.names: field required."


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "null", b"\xff\xfe", "[" * 100_000])
def test_what_is_no_card_is_refused(tmp_path, text):
    assert refused(tmp_path, text) == "not a policy card, which is a JSON object."


def test_a_huge_card_is_refused(tmp_path):
    assert (
        refused(tmp_path, " " * 1_000_001) == "the file is larger than 1000000 bytes, the most it may have."
    )


@settings(deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 1500), put=st.binary(max_size=4))
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
