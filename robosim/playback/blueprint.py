"""How a recording is laid out in the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from robosim.arena.model import Arena
from robosim.playback import entities, palette

_PLAYBACK_FPS = 20.0

_MODE_STEPS = 200
"""Decisions before and after the present one that the lanes of modes show."""

_LANE_SECONDS = 60.0
"""Time before and after the present that the lanes of a controller's log show, s."""

_TRACK_SECONDS = 20.0
"""How long a robot's track is seen, s."""

_WIDE = 2.2
"""An arena this many times wider than high takes the whole width of the window."""


def make_blueprint(
    arena: Arena, robots: int, *, follow: bool = False, learning: bool = False, rewards: bool = True
) -> rrb.Blueprint:
    """Return the layout: the arena as large as its shape allows, modes below it, plots and log around.

    With `follow` the viewer shows the newest moment as a run goes on, and with `learning` the curves of a
    training, before the plots of its episodes. Without `rewards` there is no plot of them.
    """
    width, height = arena.size
    modes = _mode_views()
    delivered = _plot("Pellets delivered by the team", entities.DELIVERED, legend=False)
    each = _plot("Pellets delivered by each robot", entities.DELIVERED_BY_ROBOT, legend=robots <= 10)
    density = _plot("Tunnel density, robots per cell of length", entities.DENSITY, legend=False)
    plotted = [delivered, each, density]
    if rewards:
        plotted.append(_plot("Reward, mean of the team and of 20 decisions", entities.REWARD, legend=False))
    words = _words()
    view, legend = _arena_view(arena), _legend_view(len(palette.legend(arena.team(robots))))
    playing: Literal["following", "paused"] = "following" if follow else "paused"
    layout: rrb.Container
    if width > _WIDE * height:
        plots: rrb.Container = rrb.Grid(*plotted, grid_columns=2, name="Plots of the episode")
        if learning:
            plots = rrb.Tabs(_learning_curves(), plots)
        lower = rrb.Horizontal(modes, plots, words, column_shares=[1.6, 1.7, 0.8])
        layout = rrb.Vertical(view, legend, lower, row_shares=[4.6, 0.4, 4.0])
    else:
        left = rrb.Vertical(view, legend, modes, row_shares=[5.0, 0.4, min(0.6 + 0.28 * (robots + 1), 4.0)])
        right: rrb.Container = rrb.Vertical(
            *plotted, words, row_shares=[1.2, 1.2, 1.0, 1.0, 1.3][-len(plotted) - 1 :], name="Episode"
        )
        if learning:
            right = rrb.Tabs(_learning_curves(), right)
        layout = rrb.Horizontal(left, right, column_shares=[2.4, 1.0])
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.STEP, fps=_PLAYBACK_FPS, play_state=playing),
        auto_views=False,
        auto_layout=False,
    )


def make_control_blueprint(arena: Arena, robots: int) -> rrb.Blueprint:
    """Return the layout for a controller's log: the arena, lanes of what robots did and why, commands."""
    view, legend = _arena_view(arena), _legend_view(len(palette.control_legend(arena.team(robots))))
    lanes = rrb.Tabs(
        *(
            rrb.StateTimelineView(
                origin=origin,
                name=name,
                time_view=rrb.TimeAxis(
                    view_range=rrb.TimeRange(
                        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_LANE_SECONDS),
                        end=rrb.TimeRangeBoundary.cursor_relative(seconds=_LANE_SECONDS),
                    )
                ),
            )
            for origin, name in (
                (entities.STOPS, "Why robots are stopped"),
                ("modes", "What each robot does"),
                (entities.DECIDED, "What each decided"),
                (entities.TOUCHED, "What each has touched"),
            )
        ),
        active_tab=1,
    )
    plots = [
        _plot("Left wheels, commanded, rad/s", entities.LEFT_SPEED, legend=robots <= 10),
        _plot("Right wheels, commanded, rad/s", entities.RIGHT_SPEED, legend=False),
        _plot("Age of poses, s", entities.AGE, legend=False),
    ]
    left = rrb.Vertical(view, legend, lanes, row_shares=[5.0, 0.4, min(0.6 + 0.28 * (robots + 1), 4.0)])
    right = rrb.Vertical(*plots, _words(), row_shares=[1.0, 1.0, 0.8, 1.6])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[2.4, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def make_beside_blueprint(arena: Arena, robots: int, scenes: Mapping[str, str]) -> rrb.Blueprint:
    """Return the layout for runs of one team side by side; `scenes` are their roots and names."""
    width, height = arena.size
    views = [_arena_view(arena, root, name) for root, name in scenes.items()]
    # Wide arenas above each other, others beside.
    pictures: rrb.Container = rrb.Vertical(*views) if width > height else rrb.Horizontal(*views)
    first = next(iter(scenes))
    legend = _legend_view(len(palette.legend(arena.team(robots))), first)
    plots = [
        _plot(name, "/", legend=True, contents=[f"/{root}/{path}" for root in scenes])
        for name, path in (
            ("Pellets delivered by the team", entities.DELIVERED),
            ("Tunnel density, robots per cell of length", entities.DENSITY),
        )
    ]
    lanes = [_lanes(name, f"/{root}/modes") for root, name in scenes.items()]
    words = [view for root in scenes for view in _word_views(f"/{root}", f", {root}")]
    left = rrb.Vertical(pictures, legend, row_shares=[9.0, 0.6])
    right = rrb.Vertical(*plots, rrb.Tabs(*lanes), rrb.Tabs(*words), row_shares=[1.0, 1.0, 1.2, 1.0])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.7, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.STEP, fps=_PLAYBACK_FPS, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _words() -> rrb.Tabs:
    return rrb.Tabs(*_word_views("", ""))


def _word_views(root: str, of: str) -> list[rrb.View]:
    return [
        rrb.TextLogView(
            origin=f"{root}/log",
            name=f"Events{of}",
            columns=rrb.TextLogColumns(text_log_columns=[TextLogColumn("Body")]),
        ),
        rrb.TextDocumentView(origin=f"{root}/{entities.ABOUT}", name=f"About this run{of}"),
    ]


def _learning_curves() -> rrb.Grid:
    return rrb.Grid(
        _plot("Pellets in 1000 decisions", entities.learning("pellets"), legend=False),
        _plot("Reward per decision and robot", entities.learning("reward"), legend=False),
        _plot("Share of robots that are blocked", entities.learning("blocked"), legend=False),
        _plot("Figures of the algorithm", entities.learning("figures"), legend=True),
        grid_columns=2,
        name="Learning",
    )


def _lanes(name: str, origin: str) -> rrb.StateTimelineView:
    # A span about the cursor is in units of the timeline, so it fits `step` only.
    around = rrb.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seq=-_MODE_STEPS),
        end=rrb.TimeRangeBoundary.cursor_relative(seq=_MODE_STEPS),
    )
    return rrb.StateTimelineView(origin=origin, name=name, time_view=rrb.TimeAxis(view_range=around))


def _mode_views() -> rrb.Tabs:
    near = _lanes("What each robot does", "modes")
    whole = rrb.StateTimelineView(origin="modes", name="The same, whole run")
    return rrb.Tabs(near, whole)


def _arena_view(arena: Arena, root: str = "", name: str = "") -> rrb.Spatial2DView:
    width, height = arena.size
    margin = 0.02 * max(width, height)
    below = f"/{root}" if root else ""
    return rrb.Spatial2DView(
        origin=below or "/",
        contents=f"{below}/{entities.ARENA}/**",
        name=name or f"Arena {arena.name}",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-margin, width + margin), y_range=(-height - margin, margin)
        ),
        overrides={f"{below}/{entities.TRACKS}": _last_seconds(arena, _TRACK_SECONDS)},
    )


def _last_seconds(arena: Arena, seconds: float) -> rrb.VisibleTimeRanges:
    steps = round(seconds / arena.timing.decision_period)
    spans = {
        entities.STEP: rrb.TimeRangeBoundary.cursor_relative(seq=-steps),
        entities.TIME: rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
    }
    now = rrb.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(timeline, start=start, end=now) for timeline, start in spans.items()]
    )


def _legend_view(entries: int, root: str = "") -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=f"{root}/{entities.LEGEND}",
        titlebar=False,
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, entries - 0.5), y_range=(-0.1, 0.32)),
    )


def _plot(
    name: str, path: str, *, legend: bool, contents: Sequence[str] = ("$origin/**",)
) -> rrb.TimeSeriesView:
    whole = rrb.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin=path,
        contents=list(contents),
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )
