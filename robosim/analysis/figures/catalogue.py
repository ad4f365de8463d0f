"""The figures of a report, in its order: what each is called, what it shows, and how it is drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from robosim.analysis.figures import clogplots, maps, plots, spacetime
from robosim.analysis.figures.rendering import Rendered, render
from robosim.analysis.figures.style import look
from robosim.analysis.measure.monitor import Episode


@dataclass(frozen=True, slots=True)
class Plot:
    """A figure of a report."""

    name: str
    """Of its files, without their ending."""
    title: str
    caption: str
    """How to read it."""
    draw: Callable[[Sequence[Episode]], Figure]


FIGURES: tuple[Plot, ...] = (
    Plot(
        "space-time",
        "Who was where, and when",
        "A line for each robot: its distance from home along the tunnel, over time. Steep lines are robots "
        "at full speed, level ones stand still, and where lines of both colours meet and turn level, "
        "robots have met head-on. Hatched: where the members of a clog stood while it lasted. This is the "
        "episode with the longest clog, or the first one.",
        spacetime.space_time,
    ),
    Plot(
        "space-time-clog",
        "The longest clog from near",
        "The same, as the longest clog began and ended. The title says what caused it, how long it stood "
        "and what ended it; the numbers at the right are robots, up to fifteen.",
        spacetime.space_time_of_clog,
    ),
    Plot(
        "clog-timeline",
        "When it clogged",
        "A row for each episode, a bar for each clog, in the colour of its cause. Clogs at once are drawn "
        "one above the other. At the right, the share of the time with at least one.",
        clogplots.clog_timeline,
    ),
    Plot(
        "clog-durations",
        "How long it clogged",
        "The share of standstills that last at least so long. A straight line that falls slowly means "
        "that long clogs are nearly as common as short ones. What lies right of the dashed line counts as "
        "a clog.",
        clogplots.clog_durations,
    ),
    Plot(
        "pellets",
        "Pellets over time",
        "What the team has delivered by each moment. A level stretch is time in which nobody delivered.",
        plots.pellets_over_time,
    ),
    Plot(
        "fundamental-diagram",
        "Flow against density",
        "A point for each 30 s of each tunnel: how many robots per metre were in it, and how many per "
        "second went through. On the dashed line everybody drives at full speed; points below it have "
        "lost time. Flow that falls as density grows is congestion.",
        plots.fundamental_diagram,
    ),
    Plot(
        "lapses",
        "Lapses between passages",
        "The share of the times between consecutive passages of a tunnel that last at least so long, with "
        "the power law that fits the tail. An exponent of 2 or less means that the mean lapse has no "
        "bound: the flow clogs. The fit says little where the dashed line leaves the curve; and a lapse "
        "that the end of the run cut short is not in it.",
        plots.lapse_survival,
    ),
    Plot(
        "trip-time",
        "Where the time of a trip goes",
        "Mean time from one delivery of a robot to its next, split by mode. Trips that were not over "
        "when the episode ended are not in it, and so not the time that the last clog took from them.",
        plots.trip_times,
    ),
    Plot(
        "lorenz",
        "How the work is shared",
        "The share of all pellets that the least busy part of the team delivered. On the diagonal all do "
        "the same; the Gini coefficient is twice the area between it and the curve.",
        plots.lorenz,
    ),
    Plot(
        "occupancy",
        "Where the robots were",
        "The share of their time that robots spent in each place, mean over robots and episodes, on a "
        "logarithmic scale, smoothed over the distance that a robot drives in a decision. Circles are where "
        "clogs began.",
        maps.occupancy,
    ),
)


def draw(plot: Plot, episodes: Sequence[Episode]) -> Rendered:
    """Return a figure of the episodes of one evaluation as PNG and SVG; equal episodes give equal bytes."""
    with look():
        return render(plot.draw(episodes))
