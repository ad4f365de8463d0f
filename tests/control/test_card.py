import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.card import arena_card, card_text, read_card
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
