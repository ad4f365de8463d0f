"""Figures of a comparison: a system looks the same in all that are drawn with the same names."""

from robosim.analysis.figures.style import SERIES
from robosim.experiments.compare_figures import draw_comparison
from robosim.experiments.comparison import compare
from robosim.experiments.runs import Run, Task


def runs(system: str, robots: int) -> list[Run]:
    task = Task("paper", "grid", 300, robots)
    figures = {"pellets": (10.0, 12.0)}
    return [Run(f"{system}-{seed}", system, task, seed, figures, system=system) for seed in range(3)]


def colours(given: list[Run], names: list[str]) -> set[str]:
    """Return which colours of systems the figure over team sizes has."""
    svg = dict(draw_comparison(compare(given), given, names))["team-size"].svg.decode()
    return {colour for colour in SERIES if colour.lower() in svg.lower()}


def test_a_system_has_its_colour_whatever_others_are_drawn() -> None:
    names = ["a", "b", "c", "lanes"]
    beside = runs("lanes", 2)
    assert colours(beside + runs("c", 2), names) == {SERIES[2]}
    assert colours(beside + runs("c", 2) + runs("b", 2), names) == {SERIES[1], SERIES[2]}
    assert colours(beside + runs("c", 2) + runs("b", 2), []) == {SERIES[0], SERIES[1]}


def test_names_that_have_no_runs_are_not_drawn() -> None:
    given = runs("lanes", 2) + runs("c", 2)
    svg = dict(draw_comparison(compare(given), given, ["nobody"]))["team-size"].svg.decode()
    assert ">c<" in svg
    assert "nobody" not in svg


def test_figures_that_are_not_wanted_are_not_drawn() -> None:
    given = runs("lanes", 2) + runs("c", 2)
    every = dict(draw_comparison(compare(given), given))
    assert list(every) == ["team-size", "profiles", "improvement"]
    some = dict(draw_comparison(compare(given), given, figures=["improvement", "touches"]))
    assert some == {"improvement": every["improvement"]}
