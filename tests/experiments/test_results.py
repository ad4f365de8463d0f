import json
import platform
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import robosim
from robosim.errors import InputError
from robosim.experiments.results import Result, append_result, read_results, this_machine

ONE = Result(
    "k1", {"seed": 1, "name": "a\nb"}, {"pellets": (1.0, 2.5)}, 12.5, {"processor": "x"}, {"s": (0.1,)}
)
TWO = replace(ONE, key="k2", config={"seed": 2})


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
    assert list(found) == ["k1", "k2"]
    assert plain(found["k1"]) == plain(replace(ONE, wall_time=99.0))
    assert plain(found["k2"]) == plain(TWO)


@given(end=st.integers(0, 200))
def test_a_line_cut_short_counts_for_nothing(tmp_path_factory, end):
    path = tmp_path_factory.mktemp("results") / "results.jsonl"
    append_result(path, ONE)
    whole = path.read_bytes()
    path.write_bytes(whole + whole[: min(end, len(whole) - 2)])
    append_result(path, TWO)
    assert {key: plain(result) for key, result in read_results(path).items()} == {
        "k1": plain(ONE),
        "k2": plain(TWO),
    }


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
