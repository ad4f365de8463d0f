import io

from rich.console import Console

from robosim.learning.metrics import Metrics
from robosim.learning.progress import show_progress


def rows(steps):
    return [Metrics(step, 500, 0, 0.02, 0.1, 0.25, 4, 321.0) for step in range(500, steps + 1, 500)]


def shown(terminal):
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=150)
    with show_progress(100_000, console) as report:
        for row in rows(100_000):
            report(row)
    return out.getvalue()


def test_a_pipe_gets_at_most_fifty_lines_and_the_last():
    lines = shown(terminal=False).splitlines()
    assert len(lines) <= 51
    assert (
        lines[-1]
        == "step 100000/100000  epsilon 0.02  loss 0.1  reward +0.250  pellets/1000 8.0  321 steps/s"
    )


def test_a_terminal_gets_a_bar_with_the_same_figures():
    assert "pellets/1000 8.0  321 steps/s" in shown(terminal=True)
