from pathlib import Path

import pytest

from robosim.arena import arena_names, load_arena
from robosim.arena.shipped import shipped_folder
from robosim.errors import InputError

NINE = [
    "long", "paper", "paper-grid", "relay", "robotarium", "s-bend", "single-lane", "three-wide", "two-tunnels"
]  # fmt: skip


def refusal(name_or_path: str | Path) -> str:
    with pytest.raises(InputError) as caught:
        load_arena(name_or_path)
    return str(caught.value)


def test_nine_ship() -> None:
    assert arena_names() == NINE


def test_names_work_from_any_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_arena("paper").name == "paper"


def test_a_path_works_where_a_name_does(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text((shipped_folder("arenas") / "paper.toml").read_text().replace('"paper"', '"own"'))
    assert load_arena(own).name == load_arena(str(own)).name == "own"
    assert load_arena(own).file == str(own)


def test_an_arena_is_taken_from_memory_until_its_file_changes(tmp_path: Path) -> None:
    text = (shipped_folder("arenas") / "paper.toml").read_text()
    own = tmp_path / "own.toml"
    own.write_text(text)
    before = load_arena(own)
    assert load_arena(own) is before
    own.write_text(text.replace("count = 60", "count = 59"))
    assert (before.pellets.count, load_arena(own).pellets.count) == (60, 59)


def test_unknown_name_offers_the_nearest() -> None:
    assert refusal("papr") == "No arena is named 'papr': did you mean paper or paper-grid?"
    assert refusal("zzz") == f"No arena is named 'zzz': known names are {', '.join(NINE)}."
    assert refusal("") == f"No arena is named '': known names are {', '.join(NINE)}."


def test_missing_file(tmp_path: Path) -> None:
    assert refusal(tmp_path / "no.toml") == f"{tmp_path}/no.toml: there is no such arena file."
    assert refusal("no.toml") == "no.toml: there is no such arena file."


def test_directory(tmp_path: Path) -> None:
    sentence = f"{tmp_path}: this is a directory; an arena file is needed here."
    assert refusal(tmp_path) == refusal(str(tmp_path)) == sentence


def test_not_utf8(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(b'name = "\xff"')
    assert refusal(file) == f"{file}: byte 8 is not UTF-8, as it must be in an arena file."


def test_too_large(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(b"#" * 1_000_001)
    assert refusal(file) == f"{file}: larger than 1000000 bytes, the most that an arena file may have."


@pytest.mark.parametrize("path", ["a\0b", "a\0b.toml", "x" * 5000, "/dev/null/x.toml"])
def test_impossible_paths_are_refused(path: str) -> None:
    assert refusal(path)
