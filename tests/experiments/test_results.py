import json
import platform
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import robosim
from robosim.errors import InputError
from robosim.experiments.keys import key_of
from robosim.experiments.results import Result, ResultsFile, append_result, read_results, this_machine

CONFIG = {"seed": 1, "name": "a\nb", "key": {"key": "k"}}
ONE = Result(key_of(CONFIG), CONFIG, {"pellets": (1.0, 2.5)}, 12.5, {"processor": "x"}, {"s": (0.1,)})
TWO = replace(ONE, key=key_of({"seed": 2}), config={"seed": 2})


def plain(result):
    return json.loads(
        json.dumps(
            [result.key, result.config, result.figures, result.series, result.wall_time, result.machine]
        )
    )


def test_a_line_for_each_result_and_the_latest_of_a_key_counts(tmp_path):
    path = tmp_path / "results.jsonl"
    assert read_results(path) == {}
    for result in (ONE, TWO, replace(ONE, wall_time=99.0)):
        append_result(path, result)
    assert len(path.read_text().splitlines()) == 3
    found = read_results(path)
    assert list(found) == [ONE.key, TWO.key]
    assert plain(found[ONE.key]) == plain(replace(ONE, wall_time=99.0))
    assert plain(found[TWO.key]) == plain(TWO)


def test_blank_lines_count_for_nothing(tmp_path):
    path = tmp_path / "results.jsonl"
    append_result(path, ONE)
    path.write_text("\n" + path.read_text() + "  \n\n")
    append_result(path, TWO)
    assert list(read_results(path)) == [ONE.key, TWO.key]


@given(end=st.integers(0, 300))
def test_a_line_cut_short_counts_for_nothing(tmp_path_factory, end):
    path = tmp_path_factory.mktemp("results") / "results.jsonl"
    append_result(path, ONE)
    whole = path.read_bytes()
    path.write_bytes(whole + whole[: min(end, len(whole) - 2)])
    append_result(path, TWO)
    assert {key: plain(result) for key, result in read_results(path).items()} == {
        ONE.key: plain(ONE),
        TWO.key: plain(TWO),
    }


@given(ends=st.lists(st.integers(0, 300), min_size=1, max_size=3))
def test_a_record_behind_a_line_cut_short_is_not_lost(tmp_path_factory, ends):
    path = tmp_path_factory.mktemp("results") / "results.jsonl"
    append_result(path, ONE)
    whole = path.read_bytes()
    # As `cat there >> here` leaves it; only the end of the line may be missing, too.
    cut = b"".join(whole[: min(end, len(whole) - 1)] for end in ends)
    append_result(path, TWO)
    two = path.read_bytes()[len(whole) :]
    path.write_bytes(cut + two + whole)
    assert {key: plain(result) for key, result in read_results(path).items()} == {
        ONE.key: plain(ONE),
        TWO.key: plain(TWO),
    }


@pytest.mark.parametrize("cut", ['{"key":', f'{{"key":"{"0" * 64}",', f'{{"key":"{"0" * 64}"}}'])
def test_a_line_of_very_many_records_is_a_sentence(tmp_path, cut):
    path = tmp_path / "results.jsonl"
    path.write_text(cut * 100_000)
    with pytest.raises(InputError) as caught:
        read_results(path)
    assert str(caught.value).startswith(f"{path}: line 1 is no result (")


@pytest.mark.parametrize(
    ("values", "wrong"),
    [
        ("123", 'pellets is "123", but must be a list of numbers'),
        ([True], "pellets holds true, but must hold finite numbers up to 1e+15"),
        (["5"], 'pellets holds "5", but must hold finite numbers up to 1e+15'),
        ([1.7e308], "pellets holds 1.7e+308, but must hold finite numbers up to 1e+15"),
    ],
)
def test_a_figure_that_is_no_list_of_numbers_is_a_sentence(tmp_path, values, wrong):
    path = tmp_path / "results.jsonl"
    append_result(path, ONE)
    record = json.loads(path.read_text())
    record["figures"]["pellets"] = values
    path.write_text(json.dumps(record) + "\n")
    with pytest.raises(InputError) as caught:
        read_results(path)
    assert wrong in str(caught.value)


def test_a_file_is_read_on_where_another_process_appends(tmp_path):
    path = tmp_path / "results.jsonl"
    file = ResultsFile(path)
    assert file.read() == {}
    append_result(path, ONE)
    assert list(file.read()) == [ONE.key]
    half = len(path.read_text())
    append_result(path, TWO)
    text = path.read_text()
    for end in range(half, len(text) - 1):
        path.write_text(text[:end])
        assert list(file.read()) == [ONE.key]
    path.write_text(text)
    assert list(file.read()) == [ONE.key, TWO.key]
    # Another file in its place is read from its beginning; damage is told by its line.
    path.write_text(text[half:])
    assert list(file.read()) == [TWO.key]
    with path.open("a") as end:
        end.write("[1]\n")
    with pytest.raises(InputError) as caught:
        file.read()
    assert str(caught.value) == f"{path}: line 2 is no result (it is no table)."


def test_a_record_that_is_not_of_its_key_is_a_sentence(tmp_path):
    path = tmp_path / "results.jsonl"
    append_result(path, ONE)
    for config in ({}, {"seed": 2}):
        append_result(path, replace(ONE, config=config))
        with pytest.raises(InputError) as caught:
            read_results(path)
        assert str(caught.value) == (
            f"{path}: line 2 is no result (its key is not the SHA-256 of its config, "
            "so one of them is damaged)."
        )


@pytest.mark.parametrize(
    "line",
    [
        '{"key": "k", "config": }',
        '{"key": "k"}',
        "[1]",
        '{"key": "k", "colour": 1}',
        '{"key": ["k"], "config": {}, "figures": {}, "wall_time": 1, "machine": {}}',
        '{"key": 3, "config": {}, "figures": {}, "wall_time": 1, "machine": {}}',
        '{"key": "k", "config": 3, "figures": {}, "wall_time": 1, "machine": {}}',
        '{"key": "k", "config": {}, "figures": {}, "wall_time": "x", "machine": {}}',
        '{"key": "k", "config": {}, "figures": {"pellets": [NaN]}, "wall_time": 1, "machine": {}}',
        "[" * 5000,
    ],
)
def test_a_line_that_is_no_result_is_a_sentence(tmp_path, line):
    path = tmp_path / "results.jsonl"
    append_result(path, ONE)
    with path.open("a") as file:
        file.write(line + "\n")
    with pytest.raises(InputError) as caught:
        read_results(path)
    assert str(caught.value).startswith(f"{path}: line 2 is no result (")
    with pytest.raises(InputError, match="this is a directory; a results file is needed here"):
        read_results(tmp_path)


def test_the_machine_is_named_with_its_versions():
    machine = this_machine()
    assert list(machine) == ["processor", "platform", "python", "robosim", "numpy", "pymunk", "torch"]
    assert machine["python"] == platform.python_version()
    assert machine["robosim"] == robosim.__version__
    assert all(isinstance(value, str) and value for value in machine.values())
