import io

from rich.console import Console

from robosim.experiments.display import Display
from robosim.experiments.jobs import Failure, Job
from robosim.experiments.results import Result

JOBS = [
    Job(
        {
            "env": {"world": "grid", "robots": 2},
            "schedule": {"steps": 100},
            "run": {"technique": "iql", "seed": seed},
            "evaluation": {"episodes": 2},
        }
    )
    for seed in range(4)
]
LABELS = {job.key: f"seed={number} [bold]\x1b[2J" for number, job in enumerate(JOBS)}


def result(job):
    return Result(job.key, job.config, {"pellets": (3.0, 4.0)}, 40.0, {}, {}, 20.0)


def work(console):
    with Display(LABELS, JOBS, console) as display:
        display.known([result(JOBS[0])])
        display.begun(JOBS[1])
        display.begun(JOBS[2])
        display.at(JOBS[1], 0.5)
        # Begun again, as where a node has died: it is one job all the same.
        display.begun(JOBS[1])
        display.at(JOBS[1], 0.0)
        display.ended(JOBS[1], result(JOBS[1]))
        display.at(JOBS[1], 0.9)
        display.ended(JOBS[2], Failure(JOBS[2], "Traceback\n  lines\nZeroDivisionError: x\x1b[2J\n"))
        display.begun(JOBS[3])
        display.ended(JOBS[3], result(JOBS[3]))


def test_in_a_pipe_there_is_a_line_for_each_job_that_begins_and_ends():
    out = io.StringIO()
    work(Console(file=out, width=40))
    assert out.getvalue().splitlines() == [
        "1 of 4 runs were done before",
        "begun: seed=1 [bold]?[2J",
        "begun: seed=2 [bold]?[2J",
        "2/4  seed=1 [bold]?[2J  3.5 pellets  60 s  left 1:00",
        "3/4  seed=2 [bold]?[2J  failed: ZeroDivisionError: x?[2J  left 0:30",
        "begun: seed=3 [bold]?[2J",
        "4/4  seed=3 [bold]?[2J  3.5 pellets  60 s  left 0:00",
    ]


def test_records_of_other_runs_tell_how_long_these_take():
    out = io.StringIO()
    with Display(LABELS, JOBS[1:], Console(file=out), [result(JOBS[0])]) as display:
        display.known([])
        display.begun(JOBS[1])
        display.ended(JOBS[1], Failure(JOBS[1], "x is 7, but must be 8."))
    assert out.getvalue().splitlines()[-1] == (
        "1/3  seed=1 [bold]?[2J  failed: x is 7, but must be 8.  left 2:00"
    )


def test_in_a_terminal_there_is_a_bar_for_all_and_for_each_running_job():
    out = io.StringIO()
    console = Console(file=out, width=100, force_terminal=True, color_system=None)
    with Display(LABELS, JOBS, console) as display:
        display.known([])
        display.begun(JOBS[1])
        display.at(JOBS[1], 0.5)
    shown = out.getvalue()
    assert "seed=1 [bold]?[2J" in shown
    assert "50%" in shown
    assert "all runs" in shown
    assert "0/4  left " in shown
