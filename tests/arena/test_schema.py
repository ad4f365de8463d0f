"""The page for users says what the code does."""

import re
from pathlib import Path

import pytest

from robosim.arena import arena_names, load_arena, parse_arena
from robosim.arena.schema import ArenaFile, GroupSection
from robosim.errors import InputError, shown

PAGE = (Path(__file__).parents[2] / "docs" / "arenas.md").read_text()


def test_every_key_is_on_the_page_with_its_default_and_range() -> None:
    for name, field in ArenaFile.model_fields.items():
        section = field.annotation
        if not hasattr(section, "model_fields"):
            assert re.search(rf"^\| `{name}` \| .*\| {re.escape(field.description)} \|$", PAGE, re.MULTILINE)
            continue
        for key, value in section.model_fields.items():
            assert f"| `{name}.{key}` | {shown(value.default)} | {value.description} |" in PAGE


def test_every_key_of_a_group_is_on_the_page() -> None:
    for key, field in GroupSection.model_fields.items():
        assert re.search(
            rf"^\| `groups.{key}` \| .*\| {re.escape(field.description)} \|$", PAGE, re.MULTILINE
        )


def test_every_shipped_arena_is_on_the_page_with_its_size() -> None:
    for name in arena_names():
        arena = load_arena(name)
        width, height = arena.size
        row = f"| `{name}` | {width:.2f} x {height:.2f} | {arena.capacity} | {arena.tunnel_length} | "
        assert row in PAGE, f"docs/arenas.md lacks the row {row!r}"


def test_the_page_s_own_arena_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    assert parse_arena(text, "page").name == "dead-end"


def test_the_page_s_mistakes_are_real() -> None:
    text = load_arena("paper").text.replace("count = 60", "mass = -1\n[robot]\nlenth = 1").split("\n")
    row = text.index('map = """') + 3
    text[row] = text[row][:6] + "x" + text[row][7:]
    with pytest.raises(InputError) as caught:
        parse_arena("\n".join(text), "mine.toml")
    printed = [
        line.removeprefix("    robosim: ")
        for line in PAGE.split("\n")
        if line.startswith("    robosim: mine")
    ]
    assert str(caught.value).split("\n") == printed


@pytest.mark.parametrize(
    ("value", "text"), [(True, "true"), ("a\n", '"a\\n"'), (list(range(12)), None), ("x" * 99, None)]
)
def test_values_are_shown_short_and_in_one_line(value: object, text: str | None) -> None:
    assert shown(value) == text or (text is None and len(shown(value)) <= 80 and "..." in shown(value))
