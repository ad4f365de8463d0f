import io
from dataclasses import replace

import pytest
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


def shown(terminal, width=150, taken=None):
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=width)
    with show_progress(100_000, console) as report:
        for row in taken or rows(100_000):
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


@pytest.mark.parametrize("width", [80, 100, 200])
def test_bar_and_time_left_have_room_in_a_narrow_terminal_too(width):
    text = shown(terminal=True, width=width)
    assert "━" * 20 in text
    assert "100,000/100,000  left 0:00" in text
    assert "pellets/1000 8.0" in text


def test_pellets_are_the_mean_of_late_since_episodes_begin_together():
    begun = [replace(row, delivered=0 if number % 20 < 5 else 8) for number, row in enumerate(rows(20_000))]
    lines = shown(terminal=False, taken=begun).splitlines()
    assert "pellets/1000 0.0" in lines[0]
    # Of the last twenty rows fifteen delivered something, wherever they begin.
    assert ["pellets/1000 12.0" in line for line in lines[10:]] == [True] * len(lines[10:])
    joined = [replace(row, stage="together", step=100_000, delivered=1) for row in begun[:1]]
    assert "pellets/1000 2.0" in shown(terminal=False, taken=[*begun, *joined]).splitlines()[-1]
