"""The figures: files that open, words where there is nothing to draw, and the numbers that were measured."""

import functools
import re
import tempfile
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from matplotlib.colors import same_color

from robosim.analysis.clogs.clog import clogs_among
from robosim.analysis.figures.catalogue import FIGURES, draw
from robosim.analysis.figures.maps import smoothed
from robosim.analysis.figures.rendering import render
from robosim.analysis.figures.spacetime import spread_apart
from robosim.analysis.figures.spans import longest_clog
from robosim.analysis.figures.style import ALPHA, CAUSES, COLUMN, LADEN, PAGE, UNLADEN, look
from robosim.analysis.measure.metrics import METRICS, clogs
from robosim.analysis.measure.monitor import TeamMonitor
from robosim.analysis.measure.tails import fit_power_law
from robosim.analysis.measure.traffic import lapses
from robosim.analysis.report.writer import Watched, write_report
from robosim.arena import load_arena
from robosim.arena.model import Zone
from robosim.arena.parse import parse_arena
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.envs.vector import VectorEnv

OPEN = '''
name = "open"
cell_size = 0.15
map = """
###########
#HHH...SSS#
#HHH...SSS#
###########
"""
[pellets]
count = 10
'''
"""An arena without a tunnel."""


class Still:
    """Nobody ever moves."""

    name = "still"

    def reset(self, env):
        self.shape = env.num_envs, env.robots

    def act(self, env, observation):
        return np.full(self.shape, 4)


RUNS = {
    # name: controller, arena, robots, episodes, decisions
    "clogged": ("active", "single-lane", 12, 2, 400),
    "two tunnels": ("lanes", "two-tunnels", 3, 1, 300),
    "one robot": ("lanes", "paper", 1, 1, 50),
    "one decision": ("lanes", "paper", 2, 1, 1),
    "still": (Still(), "paper", 3, 2, 110),
    "no tunnel": ("lanes", parse_arena(OPEN, "open.toml"), 3, 1, 300),
}
COMMAND = "robosim evaluate lanes --report FOLDER"
_FOLDER = tempfile.TemporaryDirectory()


@functools.cache
def watched(name):
    """Run the episodes of `RUNS`, once."""
    controller, arena, robots, episodes, decisions = RUNS[name]
    controller = make_controller(controller) if isinstance(controller, str) else controller
    env = VectorEnv(arena, robots=robots, num_envs=episodes, episode_steps=decisions)
    monitor = TeamMonitor()
    evaluation = evaluate(controller, env, episodes, 0, watch=[monitor])
    return Watched(evaluation, monitor.episodes, monitor.trajectories, COMMAND)


@functools.cache
def report(name):
    """Write the report of a run, once, with every warning an error, and return its folder."""
    folder = Path(_FOLDER.name) / name
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_report(folder, watched(name))
    return folder


@functools.cache
def figure_of(name, run, times=1):
    """Return the figure with its artists, as drawn, of a run whose episodes are repeated so many times."""
    plot = next(plot for plot in FIGURES if plot.name == name)
    with look():
        figure = plot.draw(list(watched(run).episodes) * times)
        figure.draw_without_rendering()
    return figure


@functools.cache
def svg_of(name, run):
    return ET.parse(report(run) / "figures" / f"{name}.svg").getroot()


def words_of(name, run):
    """Return all text in a figure."""
    return " ".join(element.text for element in svg_of(name, run).iter() if element.tag.endswith("}text"))


def lines_of(axes):
    """Return (laden, points) of every robot's line in a panel of the space-time diagram."""
    found = next(one for one in axes.collections if isinstance(one, LineCollection))
    colours = found.get_colors()
    return [
        (same_color(colours[i], LADEN), segment)
        for i, segment in enumerate(found.get_segments())
        if len(segment)
    ]


def trips_metric(name, run):
    metric = next(metric for metric in METRICS if metric.name == name)
    return [metric.compute(episode) for episode in watched(run).episodes]


@pytest.mark.parametrize("run", RUNS)
def test_every_figure_opens_again_as_png_and_svg(run):
    folder = report(run) / "figures"
    assert {path.name for path in folder.iterdir()} == {
        f"{plot.name}.{kind}" for plot in FIGURES for kind in ("png", "svg")
    }
    for plot in FIGURES:
        root = svg_of(plot.name, run)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        width, height = (float(root.get(side).removesuffix("pt")) / 72 for side in ("width", "height"))
        assert round(width, 3) in {COLUMN, PAGE}
        image = matplotlib.image.imread(folder / f"{plot.name}.png")
        assert image.shape[1] == pytest.approx(200 * width, abs=1)
        assert image.shape[0] == pytest.approx(200 * height, abs=1)
        assert image.min() < 0.7 < image.max()


@pytest.mark.parametrize("run", RUNS)
def test_no_text_is_smaller_than_8_points_and_nothing_is_loaded(run):
    for plot in FIGURES:
        svg = (report(run) / "figures" / f"{plot.name}.svg").read_text()
        sizes = {float(size) for size in re.findall(r"font(?:-size)?: ([\d.]+)px", svg)}
        assert min(sizes) >= 8.0
        loaded = re.findall(r'(?:href|src)="([^"]*)"', svg) + re.findall(r"url\(([^)]*)\)", svg)
        assert all(place.startswith(("#", "data:")) for place in loaded)


@pytest.mark.parametrize(
    ("run", "name", "sentence"),
    [
        ("one robot", "lorenz", "one robot has nobody to share its work with"),
        ("one robot", "trip-time", "no trips: nobody delivered a pellet"),
        ("one robot", "pellets", "no pellet was delivered"),
        ("one robot", "fundamental-diagram", "the run is shorter than 30 s: there is no flow to average"),
        ("one robot", "lapses", "fewer than two passages: there are no lapses"),
        ("one robot", "clog-timeline", "no clogs in 1 episode"),
        ("one robot", "space-time-clog", "no clogs in 1 episode: there is none to look at from near"),
        ("one robot", "clog-durations", "no clogs, nor shorter standstills: there are no durations"),
        ("one decision", "space-time", "the run is too short for a line: there is no space-time diagram"),
        ("still", "lorenz", "no pellets were delivered: there is no work to share"),
        ("still", "fundamental-diagram", "no robot was in a tunnel: there is no flow to average"),
        ("still", "clog-timeline", "no clogs in 2 episodes"),
        ("no tunnel", "space-time", "the arena has no tunnel: there is no space-time diagram"),
        ("no tunnel", "space-time-clog", "the arena has no tunnel: there is none to look at from near"),
        ("no tunnel", "fundamental-diagram", "the arena has no tunnel: there is no flow to average"),
        ("no tunnel", "lapses", "the arena has no tunnel: there are no lapses"),
        ("no tunnel", "clog-timeline", "the arena has no tunnel: there is nothing to clog"),
        ("no tunnel", "clog-durations", "the arena has no tunnel: there are no durations"),
    ],
)
def test_a_figure_with_nothing_to_draw_says_why(run, name, sentence):
    assert sentence in words_of(name, run)


def test_equal_episodes_give_equal_bytes_whatever_the_settings_and_these_stay():
    plot = FIGURES[0]
    expected = (report("one robot") / "figures" / f"{plot.name}.svg").read_bytes()
    with mpl.rc_context({"font.size": 30.0, "svg.fonttype": "path", "axes.facecolor": "black"}):
        before = dict(mpl.rcParams)
        drawn = draw(plot, watched("one robot").episodes)
        assert dict(mpl.rcParams) == before
    assert drawn.svg == expected
    assert drawn.png == (report("one robot") / "figures" / f"{plot.name}.png").read_bytes()


def test_coordinates_are_rounded_but_never_numbers_in_words():
    with look():
        figure = mpl.figure.Figure(figsize=(3, 2))
        axes = figure.add_subplot()
        axes.plot([0.0, 1.0], [0.123456, 0.7654321])
        axes.set_yticks([0.001, 0.5004], ["0.001", "0.5004"])
        svg = render(figure).svg.decode()
    root = ET.fromstring(svg)
    words = [element.text for element in root.iter() if element.tag.endswith("}text")]
    assert {"0.001", "0.5004"} <= set(words)
    assert not re.search(r"\d\.\d{3}", re.sub(r">[^<]*<", "><", svg))


def test_pellets_end_at_the_team_s_totals():
    episodes = watched("clogged").episodes
    axes = figure_of("pellets", "clogged").axes[0]
    ends = sorted(line.get_ydata()[-1] for line in axes.lines)
    totals = [int(episode.totals.delivered.sum()) for episode in episodes]
    assert ends == sorted([*totals, np.mean(totals)])
    assert axes.lines[0].get_xdata()[-1] == pytest.approx(400 * 0.3)
    # Fourteen episodes are a band, not fourteen lines.
    assert len(figure_of("pellets", "clogged", times=7).axes[0].lines) == 1


def test_lorenz_curve_and_gini_are_those_of_the_metric():
    axes = figure_of("lorenz", "clogged").axes[0]
    mean = axes.lines[-1].get_xydata()
    assert mean[0].tolist() == [0.0, 0.0]
    assert mean[-1].tolist() == pytest.approx([1.0, 1.0])
    figures = trips_metric("Gini coefficient of the workload", "clogged")
    assert f"mean, Gini {np.mean(figures):.2f} ± {np.std(figures, ddof=1):.2f}" in words_of(
        "lorenz", "clogged"
    )
    area = float(((mean[1:, 1] + mean[:-1, 1]) * np.diff(mean[:, 0])).sum())
    assert 1.0 - area == pytest.approx(np.mean(figures))


def test_flow_against_density_has_a_point_for_each_window_and_free_flow_at_top_speed():
    episodes = watched("two tunnels").episodes
    axes = figure_of("fundamental-diagram", "two tunnels").axes[0]
    windows = episodes[0].traffic.windows
    for tunnel, line in enumerate(axes.lines[:2]):
        here = windows.tunnel == tunnel
        assert here.sum() == 3
        assert np.array_equal(line.get_xydata(), np.stack([windows.density, windows.flow], axis=1)[here])
    free = axes.lines[2].get_xydata()
    assert free[0].tolist() == [0.0, 0.0]
    assert free[1, 1] / free[1, 0] == pytest.approx(episodes[0].arena.robot.top_speed)


def test_the_exponent_in_the_legend_is_that_of_all_episodes_lapses():
    times = np.concatenate([lapses(one.traffic, 0.3) for one in watched("clogged").episodes] * 3)
    fit = fit_power_law(times)
    assert fit is not None
    axes = figure_of("lapses", "clogged", times=3).axes[0]
    assert [line.get_label() for line in axes.lines] == [
        f"{len(times)} lapses",
        f"{ALPHA} = {fit.alpha:.2f} ± {fit.error:.2f} from {fit.t_min:.3g} s on, n = {fit.values}",
    ]
    tail = axes.lines[1].get_xydata()
    slope = np.diff(np.log(tail[:, 1])) / np.diff(np.log(tail[:, 0]))
    assert slope[0] == pytest.approx(1.0 - fit.alpha)
    assert "no tail: fewer than 50, or all alike" in words_of("lapses", "two tunnels")


def test_the_timeline_has_a_bar_for_each_clog_at_its_time_in_its_colour():
    episodes = watched("clogged").episodes
    axes = figure_of("clog-timeline", "clogged").axes[0]
    bars = sorted((bar.get_x(), bar.get_width(), bar.get_facecolor()) for bar in axes.patches)
    found = sorted((clog.start, clog.end - clog.start, clog.cause) for one in episodes for clog in clogs(one))
    assert len(bars) == len(found) > 0
    for (x, width, colour), (start, length, cause) in zip(bars, found, strict=True):
        assert (x, width) == pytest.approx((start * 0.3, length * 0.3))
        assert same_color(colour, CAUSES[cause].colour)
    shares = trips_metric("time clogged", "clogged")
    assert all(f"{100 * share:.1f} %" in words_of("clog-timeline", "clogged") for share in shares)


def test_clogs_at_once_do_not_hide_each_other():
    episode = watched("clogged").episodes[1]
    clog = clogs(episode)[0]
    beside = clog._replace(members=(0,), start=clog.start + 1)
    after = clog._replace(start=clog.end, end=clog.end + 100)
    with look():
        plot = next(plot for plot in FIGURES if plot.name == "clog-timeline")
        figure = plot.draw([replace(episode, standstills=[clog, beside, after])])
    boxes = [bar.get_bbox() for bar in figure.axes[0].patches]
    assert len(boxes) == 3
    for number, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[number + 1 :] if one.x1 != other.x0)


def test_durations_are_those_of_all_standstills():
    episodes = watched("clogged").episodes
    line = figure_of("clog-durations", "clogged").axes[0].lines[0]
    stood = [(clog.end - clog.start) * 0.3 for one in episodes for clog in one.standstills]
    assert line.get_xdata() == pytest.approx(sorted(stood))
    count = sum(len(clogs_among(one.standstills)) for one in episodes)
    assert f"{count} last longer" in words_of("clog-durations", "clogged")


def test_lines_of_the_space_time_diagram_go_where_the_robots_went():
    number, clog = longest_clog(watched("clogged").episodes)
    assert clog is not None
    traffic = watched("clogged").episodes[number].traffic
    axes = figure_of("space-time", "clogged").axes[0]
    drawn = {tuple(np.round(point, 4)) for _, segment in lines_of(axes) for point in segment}
    time = traffic.track_step * 0.3
    was = {(round(t, 4), round(float(x), 4)) for t, row in zip(time, traffic.track, strict=True) for x in row}
    assert drawn == was
    for laden, segment in lines_of(axes):
        for begin, end in pairwise(segment):
            row = round(end[0] / 1.5)
            robots = np.flatnonzero(np.isclose(traffic.track[row], end[1], atol=1e-4))
            robots = [one for one in robots if np.isclose(traffic.track[row - 1, one], begin[1], atol=1e-4)]
            assert laden in traffic.track_laden[row, robots]


def test_each_tunnel_has_a_panel_with_the_lines_of_those_in_it():
    traffic = watched("two tunnels").episodes[0].traffic
    panels = figure_of("space-time", "two tunnels").axes
    assert [panel.get_ylabel() for panel in panels] == ["tunnel 0", "tunnel 1"]
    time = traffic.track_step * 0.3
    for tunnel, panel in enumerate(panels):
        pairs = 0
        for _, segment in lines_of(panel):
            for begin, end in pairwise(segment):
                row = int(np.flatnonzero(np.isclose(time, end[0]))[0])
                robots = np.isclose(traffic.track[row], end[1], atol=1e-4)
                robots &= np.isclose(traffic.track[row - 1], begin[1], atol=1e-4)
                assert ((traffic.track_tunnel[row - 1 : row + 1, robots] == tunnel).any(axis=0)).any()
                pairs += 1
        inside = traffic.track_tunnel == tunnel
        assert pairs == ((inside[1:] | inside[:-1]).sum())
    # `lanes` goes out by one and comes home by the other.
    assert {laden for laden, _ in lines_of(panels[0])} != {laden for laden, _ in lines_of(panels[1])}


def test_a_long_episode_is_shown_around_its_longest_clog_in_strips_that_can_be_read():
    episode = watched("clogged").episodes[1]
    clog = clogs(episode)[0]._replace(start=90_000, end=91_000)
    traffic = replace(episode.traffic, track_step=episode.traffic.track_step + 89_900)
    plot = next(plot for plot in FIGURES if plot.name == "space-time")
    with look():
        figure = plot.draw([replace(episode, decisions=100_000, standstills=[clog], traffic=traffic)])
    spans = [panel.get_xlim() for panel in figure.axes]
    assert "a part of it" in figure.axes[0].get_title(loc="left")
    assert len(spans) == 5
    hours = np.array([clog.start, clog.end]) * 0.3 / 3600
    assert spans[0][0] <= hours[0] < hours[1] <= spans[-1][1]
    for (_, end), (begin, _) in pairwise(spans):
        assert end == begin
    assert np.diff(spans, axis=1) * 3600 == pytest.approx(300.0)


def test_the_longest_clog_is_seen_from_before_it_began_with_everybody_s_number():
    number, clog = longest_clog(watched("clogged").episodes)
    axes = figure_of("space-time-clog", "clogged").axes[0]
    assert axes.get_xlim()[0] < clog.start * 0.3 < axes.get_xlim()[1]
    words = words_of("space-time-clog", "clogged")
    seconds = f"{(clog.end - clog.start) * 0.3:.0f} s"
    assert f"episode {number}: {clog.cause.value}, {seconds}, {clog.ending.value}" in words
    assert {text.get_text() for text in axes.texts} <= {str(robot) for robot in range(12)}
    places = [text.get_position()[1] for text in axes.texts]
    assert np.diff(places).min() > 0.0


@given(st.lists(st.floats(0.0, 10.0), max_size=12), st.floats(0.01, 2.0))
def test_numbers_are_moved_apart_together_as_little_as_it_takes(places, apart):
    place = np.sort(np.array(places))
    at = spread_apart(place, apart)
    assert np.diff(at).min(initial=apart) >= apart * (1 - 1e-9)
    if np.diff(place).min(initial=apart) >= apart:
        assert at == pytest.approx(place)
    if len(place):
        assert at.mean() == pytest.approx(place.mean())


def test_the_map_shows_all_of_the_robots_time_and_nobody_in_a_wall():
    episodes = watched("clogged").episodes
    image = figure_of("occupancy", "clogged").axes[0].images[0]
    assert image.get_array().sum() == pytest.approx(1.0, abs=0.01)
    counts = np.random.default_rng(0).integers(0, 9, (8 * 4, 26 * 4))
    arena = episodes[0].arena
    free = np.kron(arena.zones != Zone.WALL, np.ones((4, 4), dtype=bool))
    spread = smoothed(counts * free, arena)
    assert spread.sum() == pytest.approx((counts * free).sum())
    assert (spread[~free] == 0.0).all()
    assert spread.min() >= 0.0


def test_robots_that_drive_in_step_leave_no_stripes_on_the_map():
    arena = load_arena("two-tunnels")
    counts = np.zeros((arena.rows * 4, arena.columns * 4), dtype=int)
    tunnel = arena.zones == Zone.TUNNEL
    row = int(np.flatnonzero(tunnel.any(axis=1))[0])
    columns = np.flatnonzero(tunnel[row])
    # A decision at top speed is 0.06 m, and a square 0.0375 m.
    for step in range(27):
        counts[4 * row + 2, int((columns[0] * 0.15 + 0.06 * step) / 0.0375)] += 100
    inner = smoothed(counts, arena)[4 * row + 2, 4 * columns[0] + 4 : 4 * columns[-1] - 4]
    assert inner.max() / inner.min() < 1.3


def test_bars_of_a_trip_add_up_to_its_time():
    axes = figure_of("trip-time", "clogged").axes[0]
    trips = [trip for one in watched("clogged").episodes for trip in one.trips]
    rows = {}
    for bar in axes.patches:
        row = round(bar.get_y() + 0.5 * bar.get_height())
        rows[row] = rows.get(row, 0.0) + bar.get_width()
    assert rows[0] == pytest.approx(np.mean([sum(trip.seconds) for trip in trips]))
    for robot in range(12):
        mine = [sum(trip.seconds) for trip in trips if trip.robot == robot]
        assert rows[robot + 1] == pytest.approx(np.mean(mine) if mine else 0.0)
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["team", *map(str, range(12))]


def test_colours_of_laden_and_unladen_differ_in_brightness_too():
    def brightness(colour):
        return float(np.dot(mpl.colors.to_rgb(colour), (0.299, 0.587, 0.114)))

    assert abs(brightness(LADEN) - brightness(UNLADEN)) > 0.08
