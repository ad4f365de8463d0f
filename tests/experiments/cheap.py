"""Jobs that cost nothing, for processes that are spawned to import; and a script that runs some."""

import os
import signal
import sys
import time
from pathlib import Path

from robosim.errors import InputError
from robosim.experiments.jobs import Job, Outcome
from robosim.experiments.local import LocalEngine
from robosim.experiments.results import Result, append_result, read_results
from robosim.experiments.runner import run_jobs


def count(folder):
    """Return how often this has been called in a folder."""
    with (folder / "calls").open("a") as calls:
        calls.write("x")
    return len((folder / "calls").read_text())


def square(config, folder, report):
    calls = count(folder)
    report(0.25)
    report(0.75)
    return Outcome({"square": [config["x"] ** 2, config["x"] ** 2 + 1], "calls": [calls]}, 0.5)


def misbehave(config, folder, report):
    """Do as the configuration says, the first time; afterwards all goes well."""
    calls, how = count(folder), config["how"]
    if calls == 1 and how == "raise":
        raise ZeroDivisionError("a job's own mistake")
    if calls == 1 and how == "refuse":
        raise InputError("x is 7, but must be 8.")
    if calls == 1 and how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if calls == 1 and how == "exit":
        os._exit(3)
    if calls == 1 and how == "unsent":
        return Outcome({"figure": ["no number"]}, 0.0)
    return Outcome({"calls": [calls]}, 0.0)


def overtaken(config, folder, report):
    """Record the next job's result, as another sweep of the same jobs would do; then do as usual."""
    other, results = Job({**config, "x": config["x"] + 1}), Path(config["results"])
    if other.key not in read_results(results):
        append_result(results, Result(other.key, other.config, {"square": (-1.0,)}, 0.0, {}))
    return square(config, folder, report)


def damaging(config, folder, report):
    """Work, and leave in the results what is none."""
    with Path(config["results"]).open("a") as results:
        results.write("[1]\n")
    return square(config, folder, report)


def slow(config, folder, report):
    time.sleep(0.5)
    return square(config, folder, report)


def threads(config, folder, report):
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return Outcome({name: [float(os.environ.get(name, "nan"))] for name in names}, 0.0)


def long(config, folder, report):
    """Work until asked to end, and save what has been done; the second time, end at once."""
    if (folder / "saved").exists():
        return Outcome({"found": [float((folder / "saved").read_text())]}, 0.0)

    def save(number, frame):
        (folder / "saved").write_text(f"{config['x']}")
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, save)
    (folder / "started").write_text(f"{os.getpid()}")
    # A signal that comes just before a wait begins does not end that wait.
    for _ in range(600):
        time.sleep(0.1)
    raise TimeoutError("nobody asked this job to end")


launched = 0


def interrupt_at_second_start(frame, event, argument):
    """Send this process SIGINT as soon as the second job has started, before its engine knows."""
    global launched
    if event == "return" and frame.f_code.co_qualname == "BaseProcess.start":
        launched += 1
        if launched == 2:
            signal.raise_signal(signal.SIGINT)


if __name__ == "__main__":
    from tests.experiments import cheap

    # Whoever runs the tests in the background may have let Ctrl-C be ignored, which processes inherit.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    root = Path(sys.argv[1])
    if "interrupted" in sys.argv:
        sys.setprofile(interrupt_at_second_start)
    jobs = [Job({"x": x}) for x in range(4)]
    summary = run_jobs(jobs, cheap.long, root, root / "results.jsonl", LocalEngine(2))
    print([result.figures["found"] for result in summary.results])
