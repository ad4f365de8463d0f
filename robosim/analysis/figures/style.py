"""The look of the report's figures: sizes, and colours that colour-blind people see apart."""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from robosim.analysis.clogs.clog import Cause
from robosim.discretise.modes import Mode

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

COLUMN = 3.4
"""Width of a figure for one column of a paper, inches."""
PAGE = 7.0
"""Width of a figure for both columns, inches."""

MOST_ROWS = 40
"""The most rows of bars in a figure."""

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"

INK = "#22252a"
QUIET = "#6b717a"
FAINT = "#c3c7cd"
PAPER = "#ffffff"

# The colours are those of Okabe and Ito (2008), some of them lighter. Blue goes out for a pellet.
UNLADEN = "#0072b2"
LADEN = "#d55e00"
CLOG_PLACE = "#0072b2"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")

MODES: dict[Mode, tuple[str, str]] = {
    Mode.EXIT_HOME: ("Exit-home", "#56b4e9"),
    Mode.GOING_TO_DIG: ("Going-to-dig", "#0072b2"),
    Mode.DIGGING: ("Digging", "#cc79a7"),
    Mode.EXIT_DIGGING: ("Exit-digging", "#8fd3bd"),
    Mode.GOING_HOME: ("Going-home", "#009e73"),
    Mode.DUMPING: ("Dumping", "#f0e442"),
    Mode.COLLISION: ("Collision", "#d55e00"),
}
"""Name and colour of each mode, in the order of a trip."""


class Fill(NamedTuple):
    """How a bar is filled; the hatch keeps causes apart in a black-and-white print."""

    colour: str
    hatch: str


CAUSES: dict[Cause, Fill] = {
    Cause.HEAD_ON: Fill("#d55e00", ""),
    Cause.PELLET: Fill("#e69f00", "////"),
    Cause.TURNING: Fill("#cc79a7", "...."),
    Cause.QUEUE: Fill("#56b4e9", "||||"),
}

_LOOK: dict[RcKeyType, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib, so a figure is the same everywhere
    "font.size": 8.0,
    "text.parse_math": False,  # a dollar in a name is a dollar
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "figure.facecolor": PAPER,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.linewidth": 0.5,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.borderaxespad": 0.2,
    "figure.constrained_layout.use": True,
    "axes.unicode_minus": True,
    "figure.dpi": 200.0,
    "svg.fonttype": "none",  # text stays text: it can be searched, and edited in a drawing program
    "svg.hashsalt": "robosim",  # the same names of parts in every file
}


@contextlib.contextmanager
def look() -> Iterator[None]:
    """Draw in the report's look within this block, whatever the user has set; all settings come back."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_LOOK)
        yield


def one_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure of that size in inches, and its only axes."""
    figure = Figure(figsize=(width, height))
    return figure, figure.add_subplot()


def say(axes: Axes, sentence: str) -> None:
    """Say in the middle of empty axes why there is nothing to see, and take the scales away."""
    columns = max(16, round(11.0 * axes.figure.bbox.width / axes.figure.dpi))
    axes.text(
        0.5,
        0.5,
        "\n".join(textwrap.wrap(sentence, columns)),
        transform=axes.transAxes,
        ha="center",
        va="center",
        color=QUIET,
    )
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(visible=True, color=FAINT)


def put_legend_above(figure: Figure, columns: int) -> None:
    """Put the legend of all axes above them, where it hides nothing and has the whole width."""
    figure.legend(loc="outside upper left", ncols=columns, columnspacing=1.2)


def make_log_log(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Make both axes logarithmic, with limits, and with the numbers written out."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, (low, high) in ((axes.xaxis, x), (axes.yaxis, y)):
        axis.set_major_locator(LogLocator(subs=(1.0,) if high > 50.0 * low else (1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.set_xlim(x)
    axes.set_ylim(y)


class TimeUnit(NamedTuple):
    """In which unit an axis shows time."""

    name: str
    seconds: float


def time_unit(span: float) -> TimeUnit:
    """Return the unit for a time axis over `span` seconds."""
    if span <= 120.0:
        return TimeUnit("s", 1.0)
    return TimeUnit("min", 60.0) if span <= 4.0 * 3600.0 else TimeUnit("h", 3600.0)
