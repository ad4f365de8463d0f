"""Tables of a sweep: what has a record, what has not run, and what is not to be run."""

from dataclasses import replace
from pathlib import Path

import pytest

from robosim.errors import InputError
from robosim.experiments.results import Result
from robosim.experiments.sweep import Sweep, read_sweep
from robosim.experiments.tables import WALL_TIME, SweepTable, sweep_table

FILE = """
about = "x"
[options]
world = "grid"
[vary]
robots = [4, 1]
technique = ["lanes", "iql"]
seed = [0, 1, 2, 3]
[[where]]
match = { technique = "iql" }
trials = [ { learning_rate = 0.001 }, { learning_rate = 0.01 } ]
[[where]]
match = { technique = "iql", robots = 1 }
skip = "one robot has nobody to meet"
"""


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    path = tmp_path / "s.toml"
    path.write_text(FILE)
    return read_sweep(path)


def record(sweep: Sweep, pellets: dict[tuple[str, int, int, float | None], list[float]]) -> dict[str, Result]:
    """Records of the runs with these technique, robots, seed and learning rate."""
    results = {}
    for run in sweep.runs:
        named = run.options
        place = (named["technique"], named["robots"], named["seed"], named.get("learning_rate"))
        if run.job is not None and place in pellets:
            figures = {"pellets": pellets[place], "touches": [2.0 * value for value in pellets[place]]}
            results[run.job.key] = Result(run.job.key, run.job.config, figures, 1.0, {})
    return results


def table(sweep: Sweep, figure: str = "pellets") -> SweepTable:
    four = {("iql", 4, seed, 0.001): [10.0 * seed, 10.0 * seed + 2.0] for seed in range(4)}
    some = {("iql", 4, 0, 0.01): [7.0], ("iql", 4, 1, 0.01): [9.0]}
    lanes = {("lanes", 1, seed, None): [50.0] for seed in range(4)}
    return sweep_table(sweep, record(sweep, four | some | lanes), figure)


def test_a_cell_is_the_interquartile_mean_of_the_means_of_runs(sweep: Sweep) -> None:
    cell = table(sweep).cell("`iql`, `learning_rate` 0.001", robots=4)
    assert (cell.planned, cell.scores) == (4, [1.0, 11.0, 21.0, 31.0])
    assert cell.iqm == 16.0
    assert cell.shown().startswith("16 [")
    touches = table(sweep, "touches").cell("`iql`, `learning_rate` 0.001", robots=4)
    assert touches.scores == [2.0, 22.0, 42.0, 62.0]


def test_what_did_not_run_is_said_and_never_guessed(sweep: Sweep) -> None:
    found = table(sweep)
    assert found.cell("`iql`, `learning_rate` 0.01", robots=4).shown() == "7, 9 (2 of 4)"
    assert found.cell("`lanes`", robots=4).shown() == "not run"
    assert found.cell("`lanes`", robots=4).iqm is None
    assert found.cell("`lanes`", robots=1).shown() == "50 [50, 50]"
    assert found.cell("`iql`, `learning_rate` 0.01", robots=1).shown() == "none"
    assert list(found.reasons()) == [
        f"`iql`, `learning_rate` {rate}, 1 robot: one robot has nobody to meet." for rate in (0.001, 0.01)
    ]


def test_a_record_without_the_figure_is_no_run_that_is_missing(sweep: Sweep) -> None:
    lanes = record(sweep, {("lanes", 1, seed, None): [50.0] for seed in range(4)})
    lanes = {key: replace(result, figures={"pellets": [50.0]}) for key, result in lanes.items()}
    iql = record(sweep, {("iql", 4, seed, 0.001): [10.0, 10.0] for seed in range(3)})
    first = next(iter(iql))
    iql[first] = replace(iql[first], figures={"pellets": [10.0], "touches": []})
    found = sweep_table(sweep, lanes | iql, "touches")
    assert found.cell("`lanes`", robots=1).shown() == "no figure"
    assert found.cell("`lanes`", robots=1).iqm is None
    cell = found.cell("`iql`, `learning_rate` 0.001", robots=4)
    assert cell.shown() == "20, 20 (3 of 4, no figure in 1)"
    del lanes[next(iter(lanes))]
    assert sweep_table(sweep, lanes, "touches").cell("`lanes`", robots=1).shown() == "no figure (3 of 4)"


def test_a_table_of_the_time_to_learn_has_those_that_learned(sweep: Sweep) -> None:
    lanes = record(sweep, {("lanes", 1, seed, None): [50.0] for seed in range(4)})
    iql = record(sweep, {("iql", 4, seed, 0.001): [10.0, 10.0] for seed in range(4)})
    iql = {key: replace(result, wall_time=80.0) for key, result in iql.items()}
    lanes = {key: replace(result, wall_time=0.0) for key, result in lanes.items()}
    found = sweep_table(sweep, lanes | iql, WALL_TIME)
    assert found.cell("`iql`, `learning_rate` 0.001", robots=4).scores == [80.0] * 4
    assert found.cell("`lanes`", robots=1).shown() == "no figure"


def test_the_table_in_markdown_has_columns_by_size_and_rows_in_the_order_of_the_sweep(sweep: Sweep) -> None:
    found = table(sweep)
    one, four = found.columns
    lines = list(found.lines(above={"`lanes`": {one: "43", four: "73"}}))
    assert lines[:3] == ["| | 1 robot | 4 robots |", "|---|---|---|", "| `lanes` in the paper | 43 | 73 |"]
    assert lines[3] == "| `lanes` | 50 [50, 50] | not run |"
    assert [line.split(" | ")[0] for line in lines[4:]] == [
        "| `iql`, `learning_rate` 0.001",
        "| `iql`, `learning_rate` 0.01",
    ]


def test_a_cell_that_there_is_not_is_one_sentence(sweep: Sweep) -> None:
    with pytest.raises(InputError, match="no system"):
        table(sweep).cell("`ia2c`", robots=4)
    with pytest.raises(InputError, match="no column"):
        table(sweep).cell("`lanes`", robots=3)
