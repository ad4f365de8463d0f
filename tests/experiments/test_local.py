import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robosim.errors import InputError
from robosim.experiments.jobs import Job
from robosim.experiments.local import LocalEngine
from robosim.experiments.results import Result, read_results
from robosim.experiments.runner import Watch, run_jobs
from tests.experiments import cheap


def run(tmp_path, configs, work, workers=1, **options):
    jobs = [Job(config) for config in configs]
    engine = LocalEngine(workers)
    return run_jobs(jobs, work, tmp_path / "jobs", tmp_path / "results.jsonl", engine, **options)


class Notes(Watch):
    """Writes down what it hears."""

    def __init__(self):
        self.heard = []

    def known(self, results):
        self.heard.append(("known", len(results)))

    def begun(self, job):
        self.heard.append(("begun", str(job.config["x"])))

    def at(self, job, done):
        self.heard.append((str(job.config["x"]), done))

    def ended(self, job, outcome):
        self.heard.append(("ended", str(job.config["x"]), isinstance(outcome, Result)))


def test_every_job_is_worked_off_once_and_its_result_is_a_line(tmp_path):
    configs, notes = [{"x": x} for x in (3, 1, 2)], Notes()
    summary = run(tmp_path, [*configs, {"x": 1}], cheap.square, workers=2, watch=notes)
    assert summary.failures == []
    assert [result.figures["square"][0] for result in summary.results] == [9.0, 1.0, 4.0, 1.0]
    assert notes.heard[:3] == [("known", 0), ("begun", "3"), ("begun", "1")]
    for x in "123":
        own = [one for one in notes.heard if x in one]
        assert own == [("begun", x), (x, 0.25), (x, 0.75), ("ended", x, True)]
    assert {key: result.figures for key, result in read_results(tmp_path / "results.jsonl").items()} == {
        result.key: result.figures for result in summary.results
    }
    # What is in the file is not done again, whatever has become of the folders.
    again = run(tmp_path, [*configs, {"x": 5}], cheap.square)
    assert [result.figures["square"][0] for result in again.results] == [9.0, 1.0, 4.0, 25.0]
    assert [result.figures["calls"] for result in again.results] == [(1.0,)] * 4
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 4


def test_what_another_process_has_recorded_before_a_jobs_turn_is_not_done_again(tmp_path):
    configs = [{"x": x, "results": str(tmp_path / "results.jsonl")} for x in range(4)]
    notes = Notes()
    summary = run(tmp_path, configs, cheap.overtaken, watch=notes, keep=False)
    assert [result.figures["square"][0] for result in summary.results] == [0.0, -1.0, 4.0, -1.0]
    assert [one[0] for one in notes.heard if one[0] in ("begun", "ended")] == [
        "begun", "ended", "ended", "begun", "ended", "ended",
    ]  # fmt: skip
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 4
    assert list((tmp_path / "jobs").iterdir()) == []


def test_two_processes_at_the_same_jobs_record_each_once(tmp_path):
    code = (
        "from pathlib import Path; from robosim.experiments.jobs import Job\n"
        "from robosim.experiments.local import LocalEngine; from robosim.experiments.runner import run_jobs\n"
        "from tests.experiments import cheap\n"
        "if __name__ == '__main__':\n"
        f"    root, jobs = Path({str(tmp_path)!r}), [Job({{'x': x}}) for x in range(6)]\n"
        "    s = run_jobs(jobs, cheap.slow, root / 'jobs', root / 'r.jsonl', LocalEngine(1), keep=False)\n"
        "    print({failure.reason.split(': ')[1] for failure in s.failures})\n"
    )
    (tmp_path / "both.py").write_text(code)
    root = Path(__file__).parents[2]
    both = [
        subprocess.Popen(
            [sys.executable, tmp_path / "both.py"],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            text=True,
            stdout=subprocess.PIPE,
        )
        for _ in range(2)
    ]
    # The last one may be at work in the other still; each is recorded once.
    busy = "{'another process is at work in this folder.'}\n"
    assert all(process.communicate(timeout=120)[0] in ("set()\n", busy) for process in both)
    lines = (tmp_path / "r.jsonl").read_text().splitlines()
    assert len(read_results(tmp_path / "r.jsonl")) == 6
    assert len(lines) == 6
    assert list((tmp_path / "jobs").iterdir()) == []


def test_damage_to_the_results_stops_no_job_at_work(tmp_path):
    configs = [{"x": x, "results": str(tmp_path / "results.jsonl")} for x in range(3)]
    summary = run(tmp_path, configs, cheap.damaging)
    assert [result.figures["square"][0] for result in summary.results] == [0.0, 1.0, 4.0]
    with pytest.raises(InputError, match=r"results\.jsonl: line 1 is no result \(it is no table\)\."):
        run(tmp_path, configs, cheap.damaging)


def test_a_job_that_fails_stops_no_other_and_is_tried_again(tmp_path):
    configs = [{"how": how} for how in ("raise", "fine", "refuse", "killed", "exit", "unsent", "well")]
    summary = run(tmp_path, configs, cheap.misbehave, workers=2)
    assert [bool(result) for result in summary.results] == [
        how in ({"how": "fine"}, {"how": "well"}) for how in configs
    ]
    reasons = {failure.job.config["how"]: failure.reason for failure in summary.failures}
    assert reasons.pop("raise").endswith("ZeroDivisionError: a job's own mistake\n")
    assert reasons.pop("unsent").endswith("could not convert string to float: 'no number'\n")
    assert reasons == {
        "refuse": "x is 7, but must be 8.",
        "killed": "the process of the job was killed by SIGKILL.",
        "exit": "the process of the job ended with code 3.",
    }
    again = run(tmp_path, configs, cheap.misbehave, workers=2)
    assert again.failures == []
    # In the same folders: those that failed find what they left.
    assert [result.figures["calls"][0] for result in again.results] == [2.0, 1.0, 2.0, 2.0, 2.0, 2.0, 1.0]


def test_a_job_has_one_thread_and_this_process_keeps_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    (result,) = run(tmp_path, [{}], cheap.threads).results
    assert set(result.figures.values()) == {(1.0,)}
    assert len(result.figures) == 3
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_wrong_input_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match="workers is 0, but must be a whole number from 1 on"):
        run(tmp_path, [{}], cheap.square, workers=0)
    (tmp_path / "results.jsonl").mkdir()
    with pytest.raises(InputError, match=r"results.jsonl: cannot be written: it is a folder"):
        run(tmp_path, [{}], cheap.square)


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file: no folder can be made here: File exists\."):
        run_jobs([Job({})], cheap.square, tmp_path / "file", tmp_path / "results.jsonl", LocalEngine())


def script(root, *arguments, **options):
    """Start a process that works off four long jobs, two at a time."""
    root.mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "tests.experiments.cheap", root, *arguments],
        cwd=Path(__file__).parents[2],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


def at_work(root):
    """Wait until two jobs are at work, and return their processes."""
    deadline = time.monotonic() + 30.0
    while True:
        started = list(root.glob("*/work/started"))
        if len(started) == 2 and all(path.read_text() for path in started):
            return [int(path.read_text()) for path in started]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for_end(pids):
    deadline = time.monotonic() + 30.0
    while any(map(alive, pids)):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def end_of(process, workers=()):
    """Wait for the end of a process, and return what it wrote: to its output and to its errors."""
    try:
        return process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        left = [pid for pid in (process.pid, *workers) if alive(pid)]
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        pytest.fail(f"{left} of {process.pid} and its jobs {workers} do not end: {process.communicate()}")


def saved(root):
    return sorted(path.read_text() for path in root.glob("*/work/saved"))


@pytest.mark.parametrize("to_the_group", [False, True], ids=["one process", "as a terminal does"])
def test_ctrl_c_lets_jobs_save_and_the_next_call_goes_on(tmp_path, to_the_group):
    root = tmp_path / "root"
    process = script(root, start_new_session=True)
    workers = at_work(root)
    if to_the_group:
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(signal.SIGINT)
    err = end_of(process, workers)[1]
    assert process.returncode != 0
    assert err.rstrip().endswith("KeyboardInterrupt")
    assert not any(map(alive, workers))
    assert saved(root) == ["0", "1"]
    # The other two start only now; when they are asked to end too, four have been saved.
    for path in root.glob("*/work/started"):
        path.unlink()
    process = script(root, start_new_session=True)
    at_work(root)
    process.send_signal(signal.SIGINT)
    end_of(process)
    assert saved(root) == ["0", "1", "2", "3"]
    out = end_of(script(root))[0]
    assert out == "[(0.0,), (1.0,), (2.0,), (3.0,)]\n"


def test_ctrl_c_while_a_job_is_being_started_leaves_no_process(tmp_path):
    process = script(tmp_path / "root", "interrupted", start_new_session=True)
    err = end_of(process)[1]
    assert err.rstrip().endswith("KeyboardInterrupt")
    assert process.returncode != 0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_jobs_end_with_the_process_above_them(tmp_path, number):
    root = tmp_path / "root"
    process = script(root)
    workers = at_work(root)
    process.send_signal(number)
    end_of(process, workers)
    wait_for_end(workers)
    assert saved(root) == ["0", "1"]
    assert read_results(root / "results.jsonl") == {}
