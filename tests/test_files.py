import contextlib
import multiprocessing
import os
import socket
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.errors import InputError
from robosim.files import (
    append_line,
    is_regular,
    remove_strays,
    require_writable,
    sync,
    whole_file,
    write_whole,
)


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_is_whole_or_not_there_and_nothing_lies_beside_it(tmp_path, durable):
    path = tmp_path / "report.json"
    write_whole(path, "one", durable)
    assert path.read_text() == "one"

    def fail():
        with whole_file(path, durable) as part:
            part.write_text("tw")
            assert part.name == f".report.json.{os.getpid()}.part"
            assert path.read_text() == "one"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_text() == "one"
    write_whole(path, b"\x00two", durable)
    assert path.read_bytes() == b"\x00two"
    assert [one.name for one in tmp_path.iterdir()] == ["report.json"]


def fifo(path):
    os.mkfifo(path)


def listener(path):
    server = socket.socket(socket.AF_UNIX)
    # A socket's name must be short.
    with contextlib.chdir(path.parent):
        server.bind(path.name)


@pytest.mark.parametrize(
    "write", [lambda path: write_whole(path, ""), require_writable, lambda path: append_line(path, "")]
)
def test_only_regular_files_are_written(tmp_path, write):
    special = [tmp_path / "pipe", tmp_path / "socket"]
    fifo(special[0])
    listener(special[1])
    link = tmp_path / "link"
    link.symlink_to("/dev/null")
    for path in (*special, link, "/dev/null"):
        before = Path(path).stat()
        with pytest.raises(InputError) as caught:
            write(path)
        assert str(caught.value) == f"{path}: cannot be written: it is not a regular file."
        after = Path(path).stat()
        assert (before.st_mode, before.st_ino) == (after.st_mode, after.st_ino)
    with pytest.raises(InputError) as caught:
        write(tmp_path)
    assert str(caught.value) == f"{tmp_path}: cannot be written: it is a folder; give the name of a file."
    for path, reason in (
        (tmp_path / "nowhere" / "file", "No such file or directory"),
        (tmp_path / "pipe" / "file", "Not a directory"),
    ):
        with pytest.raises(InputError) as caught:
            write(path)
        assert str(caught.value) == f"{path}: cannot be written: {reason}."
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "pipe", "socket"]


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "there").mkdir()
    link, target = tmp_path / "link", tmp_path / "there" / "file"
    link.symlink_to(target)
    for text in ("made", "replaced"):
        write_whole(link, text)
        assert link.is_symlink()
        assert target.read_text() == text
        assert list(target.parent.iterdir()) == [target]


def test_what_is_left_under_the_name_of_a_part_is_not_written_through(tmp_path):
    mine = tmp_path / "mine"
    mine.write_text("mine")
    (tmp_path / f".file.{os.getpid()}.part").symlink_to(mine)
    write_whole(tmp_path / "file", "new")
    assert mine.read_text() == "mine"
    assert (tmp_path / "file").read_text() == "new"
    assert not (tmp_path / "file").is_symlink()


def test_durable_waits_for_the_file_before_it_takes_its_name(tmp_path, monkeypatch):
    path, seen, fsync = tmp_path / "file", [], os.fsync

    def noted(handle):
        seen.append((str(Path(f"/proc/self/fd/{handle}").readlink()), path.exists()))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", noted)
    write_whole(path, "text")
    assert seen == []
    write_whole(path, "text", durable=True)
    part = str(tmp_path / f".file.{os.getpid()}.part")
    assert seen == [(part, True), (str(tmp_path), True)]
    sync(path)
    assert seen[2:] == [(str(path), True)]


def test_strays_are_removed_by_name_and_nothing_else(tmp_path):
    strays = [".a.toml.12.part", ".a.toml.7.probe", ".a.toml.12-345.part"]
    kept = [
        "a.toml", ".a.toml", ".a.toml.part", ".a.toml.x.part", "a.toml.12.part", ".b.toml.12.part",
        ".a.toml.12.part.bak", ".a.toml.12.partial", "..12.part",
    ]  # fmt: skip
    for name in (*strays, *kept):
        (tmp_path / name).write_text("x")
    (tmp_path / ".a.toml.99.part").mkdir()
    (tmp_path / ".a.toml.98.part").symlink_to(tmp_path / "a.toml")
    remove_strays(tmp_path, lambda name: name == "a.toml")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {*kept, ".a.toml.99.part", ".a.toml.98.part"}
    assert not is_regular(tmp_path / ".a.toml.98.part")
    assert is_regular(tmp_path / "a.toml")


@given(name=st.from_regex(r"[^/\0]{1,40}", fullmatch=True), killed=st.booleans())
def test_what_a_killed_process_leaves_is_recognised(tmp_path_factory, name, killed):
    folder = tmp_path_factory.mktemp("strays")
    try:
        (folder / name).touch()
    except (OSError, ValueError):
        return
    (folder / name).unlink()
    with whole_file(folder / name) as part:
        part.write_text("x")
        left = folder / "kept"
        os.link(part, left)
        stray = part.name
    (folder / name).unlink()
    left.rename(folder / stray)
    remove_strays(folder, lambda found: found == name)
    assert list(folder.iterdir()) == []


def append_many(path, start, lines):
    start.wait()
    for line in lines:
        append_line(path, line)


def test_lines_of_many_processes_stay_whole(tmp_path):
    context = multiprocessing.get_context("fork")
    path, start = tmp_path / "lines", context.Event()
    lines = [[f"{who} {k} " + "x" * 5000 for k in range(20)] for who in range(4)]
    workers = [context.Process(target=append_many, args=(path, start, some)) for some in lines]
    for worker in workers:
        worker.start()
    start.set()
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0
    assert sorted(path.read_text().splitlines()) == sorted(line for some in lines for line in some)


def test_a_line_cut_short_is_ended_first(tmp_path):
    path = tmp_path / "lines"
    path.write_text("whole\ncut sho")
    append_line(path, "next")
    assert path.read_text() == "whole\ncut sho\nnext\n"


def test_threads_may_write_different_files(tmp_path):
    names = [f"file {k}" for k in range(8)]
    threads = [threading.Thread(target=write_whole, args=(tmp_path / name, name * 1000)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {n: n * 1000 for n in names}
