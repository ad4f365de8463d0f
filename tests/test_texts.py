"""Files from strangers: whole regular files within bounds, TOML and JSON, or one sentence, and soon."""

from __future__ import annotations

import os
import time
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import arena_names
from robosim.arena.shipped import shipped_folder
from robosim.errors import InputError
from robosim.texts import parse_json, parse_toml, read_limited, read_text, read_toml


def refusal(path: Path, most: int = 100) -> str:
    with pytest.raises(InputError) as refused:
        read_limited(path, most, "map")
    return str(refused.value)


def test_a_regular_file_is_read_whole_and_through_links(tmp_path: Path) -> None:
    path, link = tmp_path / "a", tmp_path / "b"
    path.write_bytes(b"x" * 100)
    link.symlink_to(path)
    assert read_limited(path, 100, "map") == read_limited(link, 100, "map") == b"x" * 100
    assert refusal(path, 99) == f"{path}: larger than 99 bytes, the most that a map may have."


def test_a_mark_of_byte_order_is_no_part_of_a_text(tmp_path: Path) -> None:
    path = tmp_path / "arena.toml"
    path.write_bytes(b"\xef\xbb\xbfname = 1\n")
    assert read_toml(path, 100, "arena file") == {"name": 1}


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    assert refusal(path) == f"{path}: not a regular file, as a map must be."
    assert refusal(Path("/dev/zero")) == "/dev/zero: not a regular file, as a map must be."


def test_what_is_no_file_is_one_sentence(tmp_path: Path) -> None:
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    long = tmp_path / ("a" * 300)
    assert refusal(tmp_path) == f"{tmp_path}: this is a directory; a map is needed here."
    assert refusal(tmp_path / "none") == f"{tmp_path / 'none'}: there is no such map."
    assert refusal(circle) == f"{circle}: cannot be read: Too many levels of symbolic links."
    assert refusal(long) == f"{long}: cannot be read: File name too long."
    # How Python calls it differs from version to version.
    assert refusal(Path("a\0b")).startswith("a?b: cannot be read: ")


def test_nothing_is_read_of_a_sparse_file_that_is_too_large(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(2**40)
    assert refusal(path).endswith("larger than 100 bytes, the most that a map may have.")


def test_bytes_that_are_no_text_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"a = '\xff'")
    for read in (read_text, read_toml):
        with pytest.raises(
            InputError, match=r"a\.toml: byte 5 is not UTF-8, as it must be in an arena file\.$"
        ):
            read(path, 100, "arena file")


DEEP = "tables and lists more than 20 deep"
LONG = "a number, or a key without quotes, of more than 100 characters: "
PARTS = "a key of more than 20 parts"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a" + ".a" * 100_000 + " = 1", PARTS),
        ("a" + " .\ta" * 100_000 + " = 1", PARTS),
        ('"a"' + '.\'a\'."\\""' * 50_000 + " = 1", PARTS),
        ("[" + "a." * 100_000 + "a]", PARTS),
        ("[" * 100_000, DEEP),
        ("a = " + "[" * 5000 + "]" * 5000, DEEP),
        ("a = " + "{a = " * 21 + "1" + "}" * 21, DEEP),
        # These texts end before the brackets begin: up to two quotes of the last five belong to them.
        ('a = ["""b"""", ' + "[" * 30 + "]" * 30 + "]", DEEP),
        ("a = ['''b''''', " + "[" * 30 + "]" * 30 + "]", DEEP),
        ('a = ["\\"", ' + "[" * 30 + "]" * 30 + "]", DEEP),
        ("a = ['\\', " + "[" * 30 + "]" * 30 + "]", DEEP),
        ('a = "#"\nb = ' + "[" * 30 + "]" * 30, DEEP),
        ("a = 1" + "0" * 400, f"{LONG}1000000000000000 ..."),
        ("a = 0x" + "f" * 5000, f"{LONG}0xffffffffffffff ..."),
        ("b" * 1000 + " = 1", f"{LONG}bbbbbbbbbbbbbbbb ..."),
    ],
)
def test_what_would_take_long_to_read_is_refused_at_once(text: str, reason: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as refused:
        parse_toml(text, "a.toml")
    assert str(refused.value) == f"a.toml: not a TOML file ({reason})."
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize(
    "text",
    [
        'a = "' + "[" * 1000 + '"',
        "a = '" + "1" * 1000 + "'",
        'a = """\n' + "a.a\n" * 1000 + '"""',
        "a = '''" + "{" * 100 + "'''''",
        "# " + "[" * 1000 + "9" * 1000 + "\na = 1",
        "a = [\r\n# [[[[[[[[[[[[[[[[[[[[[[[[[[[\r\n1]",
        "\n".join(f"[a{number}.b.c]\nd = [[1, 2], [3]]" for number in range(500)),
        "a = " + "[" * 20 + "]" * 20,
        ".".join("abcdefghijklmnopqrst") + " = -1e3",
        f"a = {'9' * 100}",
    ],
)
def test_texts_and_comments_may_hold_anything(text: str) -> None:
    assert parse_toml(text, "a") == tomllib.loads(text)


@pytest.mark.parametrize("name", arena_names())
def test_arenas_that_ship_are_read_as_they_are(name: str) -> None:
    path = shipped_folder("arenas") / f"{name}.toml"
    assert read_toml(path, 1_000_000, "arena file") == tomllib.loads(path.read_text(encoding="utf-8"))


@given(st.text(st.sampled_from("ab.=[]{}\"'#\\\n ,1"), max_size=60))
def test_any_text_is_read_as_toml_or_refused(text: str) -> None:
    """Short texts are within the bounds, so that what is TOML is read."""
    try:
        table = tomllib.loads(text)
    except ValueError:
        with pytest.raises(InputError):
            parse_toml(text, "a")
    else:
        assert parse_toml(text, "a") == table


@pytest.mark.parametrize(
    "text", ["", "[1", "NaN", "[Infinity]", "[" * 100_000, "1" * 5000, "9" * 101, b"\xff", "{'a': 1}"]
)
def test_what_is_no_json_is_a_value_error(text: str | bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011  each reader says it in a sentence of its own
        parse_json(text)


def test_json_is_read() -> None:
    assert parse_json(b'{"a": [1, 2.5, null, "b", true]}') == {"a": [1, 2.5, None, "b", True]}
