import json
import sys
from pathlib import Path

import pytest

from robosim.cli.bench import Bench
from robosim.errors import InputError


@pytest.mark.parametrize("field", ["decisions", "updates"])
@pytest.mark.parametrize("value", [0, -3, 100_001])
def test_a_count_out_of_range_is_refused(field: str, value: int) -> None:
    with pytest.raises(InputError, match=f"--{field} is {value}, but must be a whole number from 1"):
        Bench(**{field: value}).run()


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bench.json"):
        Bench(json=tmp_path / "nowhere" / "bench.json").run()


def test_prints_and_writes_both_tables_without_stable_baselines3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setattr("robosim.bench.decisions.SPREAD_OUT", 1)
    monkeypatch.setattr("robosim.bench.worlds.SPREAD_OUT", 1)
    monkeypatch.setattr("robosim.bench.decisions.REPEATS", 1)
    monkeypatch.setattr("robosim.bench.worlds.TURNS", 1)
    monkeypatch.setattr("robosim.learning.benchmark.TRANSITIONS", 600)
    monkeypatch.setattr("robosim.learning.benchmark.TURN", 1)
    Bench(decisions=1, updates=1, json=tmp_path / "bench.json").run()
    record = json.loads((tmp_path / "bench.json").read_text())
    assert len(record["cases"]) == 12
    assert [(cost["world"], cost["robots"], cost["envs"]) for cost in record["worlds"]] == [
        ("physics", 8, 64), ("grid", 8, 64)
    ]  # fmt: skip
    assert {cost["batch_size"] for cost in record["learner"]["updates"]} == {64, 512}
    assert record["learner"]["stable_baselines3"] is None
    one = record["learner"]["one_for_all"]
    assert (one["robots"], one["batch_size"]) == (1, 512)
    printed = capsys.readouterr().out
    physics, grid = (cost["joint_decisions_per_second"] for cost in record["worlds"])
    assert f"the grid takes {grid / physics:.1f} times as many joint decisions a second" in printed
    for cost in record["learner"]["updates"]:
        row = f"{cost['batch_size']:5d}   {cost['precision']}"
        assert any(line.startswith(row) and f"{cost['ratio']:.2f}" in line for line in printed.splitlines())
    assert f"batch 512: {one['seconds'] * 1e6:.0f} us, {one['ratio']:.2f} times its products" in printed
    assert "stable-baselines3 is not installed" in printed
