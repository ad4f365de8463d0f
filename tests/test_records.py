"""Records: what they take, what they refuse and in which words, and their options by short names."""

from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from robosim.discretise.noise import ReadingConfig, SensingConfig
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardConfig
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.profile import ProfileConfig
from robosim.errors import InputError, shown
from robosim.records import Many, Record
from robosim.world.motion import MotionConfig


class Inner(Record):
    short_names = {"kind": "colour"}

    kind: str = Field(default="red", max_length=5)
    """What colour."""
    size: int = Field(default=3, ge=1, le=9)
    """How large."""


class Outer(Record):
    inner: Inner = Inner()
    """What is inside."""
    rate: float = Field(default=0.5, gt=0, le=2)
    """How often."""
    widths: Many[int] = Field(default=(1, 2), min_length=1, max_length=3)
    """How wide."""
    name: str | None = None
    """What it is called."""


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rate": 3}, "rate is 3, but must be a number above 0 and of at most 2."),
        ({"rate": "x" * 200}, f'rate is "{"x" * 75} ..., but must be a number above 0 and of at most 2.'),
        ({"rate": float("inf")}, "rate is inf, but must be a number above 0 and of at most 2."),
        ({"widths": []}, "widths is [], but must be a list of 1 to 3 whole numbers."),
        ({"widths": [1, 2.5]}, "widths is 2.5, but must be a list of 1 to 3 whole numbers."),
        ({"name": 5}, "name is 5, but must be a text or None."),
        ({"inner": {"size": 0}}, "inner.size is 0, but must be a whole number from 1 to 9."),
        (
            {"inner": {"kind": "purple"}},
            'inner.kind is "purple", but must be a text of at most 5 characters.',
        ),
        ({"inner": 5}, "inner is 5, but must be a table."),
        ({"colour": "red"}, '"colour" is not an option: known names are inner, name, rate, widths.'),
        ({"\x1b[2J": 1}, '"\\u001b[2J" is not an option: known names are inner, name, rate, widths.'),
    ],
)
def test_a_wrong_value_is_one_sentence(values, sentence) -> None:
    with pytest.raises(InputError) as refusal:
        Outer(**values)
    assert str(refusal.value) == sentence
    with pytest.raises(InputError) as refusal:
        Outer.from_table(values, "FILE")
    assert str(refusal.value) == f"FILE: {sentence}"


def test_lists_and_numpys_numbers_are_taken_and_records_do_not_change() -> None:
    made = Outer(widths=[4, 5], rate=np.float64(1.5))
    assert (made.widths, made.rate) == ((4, 5), 1.5)
    assert hash(made) == hash(Outer(widths=(4, 5), rate=1.5))
    with pytest.raises(ValueError, match="frozen"):
        made.rate = 1.0  # type: ignore[misc]


def test_options_are_the_fields_of_all_records_by_their_short_names() -> None:
    options = Outer.options()
    assert {name: option.path for name, option in options.items()} == {
        "colour": ("inner", "kind"),
        "inner_size": ("inner", "size"),
        "rate": ("rate",),
        "widths": ("widths",),
        "name": ("name",),
    }
    assert options["colour"].help == "What colour."


def test_with_options_changes_what_it_names_and_nothing_else() -> None:
    first = Outer(inner=Inner(kind="blue", size=2), rate=1.0)
    assert first.with_options(colour="green") == Outer(inner=Inner(kind="green", size=2), rate=1.0)
    assert first.with_options(inner=Inner(), inner_size=7, rate=2.0) == Outer(inner=Inner(size=7), rate=2.0)
    assert first.with_options() == first
    with pytest.raises(InputError, match=r"^inner\.size is 0, but must be a whole number from 1 to 9\.$"):
        first.with_options(inner_size=0)
    with pytest.raises(InputError, match='^"size" is not an option: did you mean inner_size'):
        first.with_options(size=2)


def test_every_option_of_an_environment_has_a_short_name_of_its_own_and_says_what_it_is() -> None:
    options = EnvConfig.options()
    tables = (RewardConfig, PheromoneConfig, ProfileConfig, MotionConfig, SensingConfig, ReadingConfig)
    fields = len(EnvConfig.model_fields) + sum(len(table.model_fields) - 1 for table in tables)
    assert len(options) == fields
    assert {"reward", "sharing", "signed_distance", "pheromone_decay", "reward_pickup"} <= options.keys()
    assert all(option.help for option in options.values())


@given(st.text(max_size=300) | st.binary(max_size=99) | st.integers() | st.lists(st.text()))
def test_what_is_shown_is_one_short_printable_line(value) -> None:
    text = shown(value)
    assert text.isprintable()
    assert len(text) <= 80


def test_none_leaves_every_field_as_it_is() -> None:
    named, _ = env_config("s-bend", robots=3)
    nothing = dict.fromkeys(["arena", "reward", "pheromone", *EnvConfig.options()])
    assert env_config(named, **nothing)[0] == named
    assert env_config("s-bend", **nothing | {"robots": 3})[0] == named


def test_keys_and_values_of_a_table_are_named_printably() -> None:
    class Facts(Record):
        facts: dict[Annotated[str, Field(max_length=90)], str] = Field(default={}, max_length=2)

    class Whole(Record):
        inner: Facts = Facts()

    for facts, sentence in (
        ({"how": 5}, "inner.facts.how is 5, but must be a text."),
        ({"facts": 5}, "inner.facts.facts is 5, but must be a text."),
        ({"\x1b[2J": 5}, 'inner.facts."\\u001b[2J" is 5, but must be a text.'),
        ({"a": "", "b": "", "c": ""}, "inner.facts is a table, but must be a table of at most 2 entries."),
    ):
        with pytest.raises(InputError) as refusal:
            Whole(inner={"facts": facts})
        assert str(refusal.value) == sentence
    with pytest.raises(InputError) as refusal:
        Whole(inner={"facts": {"x" * 5000: "long"}})
    assert len(str(refusal.value)) < 400
    with pytest.raises(InputError) as refusal:
        Whole.from_table({"inner": {"\x1b": {}}}, "FILE")
    assert str(refusal.value) == 'FILE: "\\u001b" is not an option of inner: known names are facts.'


def test_a_configuration_holds_the_arenas_text_and_takes_an_arena_three_ways(tmp_path) -> None:
    named, arena = env_config("paper", robots=3)
    (tmp_path / "mine.toml").write_text(arena.text)
    assert env_config(arena, robots=3)[0] == named
    assert env_config(tmp_path / "mine.toml", robots=3)[0] == named
    assert env_config(named)[0] == named
    assert env_config(named, robots=2)[0] == named.changed(robots=2)
    assert env_config(named, reward="local", pheromone_radius=1)[0] == named.changed(
        reward=named.reward.changed(kind="local"), pheromone=named.pheromone.changed(radius=1)
    )
