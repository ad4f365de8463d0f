import numpy as np

from robosim.analysis.figures.comparison import Line, Panel, Systems, pellets_against_touches
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
