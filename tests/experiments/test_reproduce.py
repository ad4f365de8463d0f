"""tools/reproduce.py: what it runs, and how that ends."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robosim.errors import InputError
from robosim.experiments.results import read_results

TOOL = Path(__file__).parents[2] / "tools" / "reproduce.py"

MANY = """
[options]
world = "grid"
robots = 1
[vary]
technique = ["lanes"]
seed = [0, {last}]
[evaluation]
episodes = 1
steps = 20
"""

RUN = """
import importlib.util, pathlib, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
spec = importlib.util.spec_from_file_location("reproduce", sys.argv.pop(1))
sys.modules["reproduce"] = tool = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tool)
tool.RESULTS = pathlib.Path("results")
sys.exit(tool.main())
"""
"""The tool, with the sweeps of another folder."""


@pytest.fixture
def tool(monkeypatch):
    spec = importlib.util.spec_from_file_location("reproduce", TOOL)
    tool = importlib.util.module_from_spec(spec)
    # Where its dataclasses look for it.
    monkeypatch.setitem(sys.modules, "reproduce", tool)
    spec.loader.exec_module(tool)
    return tool


def test_what_goes_wrong_in_a_sweep_is_its_exit_code(tmp_path, tool):
    assert tool.robosim("sweep", str(tmp_path / "nowhere.toml")) == 2
    with pytest.raises(InputError, match='no sweep is named "gird": did you mean grid'):
        tool.run(["gird"], [])


def test_the_quick_comparison_makes_its_folder_and_prints_its_table(tmp_path, tool, monkeypatch, capfd):
    (tmp_path / "quick.toml").write_text(MANY.format(last=1))
    monkeypatch.setattr(tool, "RESULTS", tmp_path)
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert tool.quick() == 0
    assert len(read_results(tmp_path / "runs" / "quick.results.jsonl")) == 2
    said = capfd.readouterr().out
    assert "2 runs done, 0 skipped" in said
    assert "lanes" in said[said.index("2 runs done") :]


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished_and_begins_no_other_sweep(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    seeds = ", ".join(map(str, range(1, 300)))
    for name in ("grid", "quick", "tuning"):
        (results / f"{name}.toml").write_text(MANY.format(last=seeds))
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, str(TOOL), "run", "--workers", "1"],
        cwd=tmp_path,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # As a terminal does, Ctrl-C is to reach the tool and all that it has started.
        start_new_session=True,
    )
    records = results / "grid.results.jsonl"
    deadline = time.monotonic() + 120.0
    try:
        while not (records.exists() and records.read_text().count("\n") >= 2):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert process.returncode == 130, err
    assert err == "robosim: interrupted\n"
    assert "Stopped; go on with: " in out
    assert [line for line in out.splitlines() if line.startswith("==")] == ["== grid"]
    kept = read_results(records)
    assert 2 <= len(kept) < 300
    assert len(kept) == records.read_text().count("\n")
    assert all(result.figures["pellets"] for result in kept.values())
