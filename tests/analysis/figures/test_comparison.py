import numpy as np
import pytest

from robosim.analysis.figures.comparison import (
    Line,
    Panel,
    Systems,
    by_team_size,
    cumulative_pellets,
    pellets_against_touches,
)
from robosim.analysis.figures.rendering import render
from robosim.analysis.figures.style import look


def test_each_run_is_a_point_of_its_system_from_no_touches_to_thousands() -> None:
    calm = Line("calm", np.array([0.0, 4.0]), np.array([90.0, 91.0]))
    rough = Line("rough", np.array([3000.0]), np.array([95.0]))
    systems = Systems(["calm", "rough"])
    figure = pellets_against_touches([Panel("2 robots", [calm, rough]), Panel("4 robots", [rough])], systems)
    drawn = [
        [(one.get_label(), one.get_xdata().tolist(), one.get_ydata().tolist()) for one in axes.lines]
        for axes in figure.axes
    ]
    assert drawn[0] == [("calm", [0.0, 4.0], [90.0, 91.0]), ("rough", [3000.0], [95.0])]
    assert [points[1:] for points in drawn[1]] == [([3000.0], [95.0])]
    assert figure.axes[0].lines[1].get_color() == figure.axes[1].lines[0].get_color()
    figure.canvas.draw()
    places = figure.axes[0].transData.transform([[0.0, 90.0], [4.0, 90.0], [3000.0, 95.0]])[:, 0]
    assert places[0] < places[1] < places[2]


def test_a_dollar_in_a_name_is_no_formula() -> None:
    lines = [Line("$\\bad$ & <b>", np.array([0.0, 4.0]), np.array([90.0, 91.0]))]
    with look():
        svg = render(pellets_against_touches([Panel("2 robots", lines)], Systems([lines[0].name]))).svg
    assert b"$\\bad$ &amp; &lt;b&gt;" in svg


@pytest.mark.parametrize(
    ("touches", "labels"),
    [
        ([0.0, 4.0], ["0", "10", "100"]),
        ([3.0, 2500.0], ["0", "10", "100", "1k", "10k"]),
        ([150.0, 900.0], ["100", "1k"]),
        ([1500.0, 13000.0], ["1k", "10k", "100k"]),
    ],
)
def test_touches_are_written_out_from_the_decade_of_the_least(
    touches: list[float], labels: list[str]
) -> None:
    line = Line("calm", np.array(touches), np.array([90.0, 91.0]))
    with look():
        figure = pellets_against_touches([Panel("2 robots", [line])], Systems(["calm"]))
        figure.draw_without_rendering()
    (axes,) = figure.axes
    low, high = axes.get_xlim()
    shown = [
        label.get_text()
        for label, place in zip(axes.get_xticklabels(), axes.get_xticks(), strict=True)
        if low <= place <= high
    ]
    assert shown == labels
    assert low <= min(touches)
    assert max(touches) <= high


def test_axes_keep_their_height_below_a_long_legend() -> None:
    def heights(count: int) -> list[float]:
        names = [f"technique-{number}" for number in range(count)]
        lines = [Line(name, np.array([0.0, 100.0]), np.array([0.0, 90.0])) for name in names]
        panels = [Panel(f"{robots} robots", lines) for robots in (2, 4, 8)]
        with look():
            figure = cumulative_pellets(panels, Systems(names))
            figure.draw_without_rendering()
        return [axes.get_position().height * figure.get_figheight() for axes in figure.axes]

    assert heights(40) == pytest.approx(heights(4), rel=0.05)


@pytest.mark.parametrize("name", ["ps-map", "ps-mappo", "iql", "ps-dqn learning_rate=0.003"])
def test_a_long_legend_stays_within_the_figure(name) -> None:
    names = [f"{name}{number}" for number in range(10, 30)]
    lines = [Line(one, np.array([1.0, 8.0]), np.array([9.0, 90.0])) for one in names]
    with look():
        figure = by_team_size([Panel("paper", lines)], Systems(names), "pellets")
        figure.draw_without_rendering()
    (legend,) = figure.legends
    assert legend.get_window_extent().x1 <= figure.bbox.x1


def test_twenty_four_systems_and_a_reference_all_look_different() -> None:
    names = [f"system {number}" for number in range(24)]
    systems = Systems(["lanes", *names], reference="lanes")
    assert len({(systems.colour(name), systems.dash(name)) for name in ["lanes", *names]}) == 25
    assert len({(systems.colour(name), systems.marker(name)) for name in ["lanes", *names]}) == 25
