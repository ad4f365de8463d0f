import io

from rich.console import Console

from robosim.learning.metrics import Metrics
from robosim.learning.progress import show_progress


def rows(steps):
    return [
        Metrics(
            step=step, decisions=500, episode=0, stage="newcomer 3", stage_step=step, robots=3, learning=1,
            reward=0.25, delivered=4, collisions=0.5, blocked=0.125, steps_per_second=321.0,
            figures={"loss": 0.1, "learning_rate": 1e-3},
        )
        for step in range(500, steps + 1, 500)
    ]  # fmt: skip


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
    assert lines[-1] == (
        "step 100000/100000  newcomer 3  pellets/1000 8.0  blocked 12%  collisions 0.50  reward +0.250  "
        "loss 0.1  learning rate 0.001  321 steps/s  left 0:00"
    )
    assert lines[0].endswith("left 5:10")


def test_a_terminal_gets_a_bar_with_the_same_figures():
    assert "pellets/1000 8.0  blocked 12%" in shown(terminal=True)
