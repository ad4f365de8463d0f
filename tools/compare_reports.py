"""Draw teams below each other: five minutes in the tunnel on the left, flow against density on the right.

    python tools/compare_reports.py REPORT... --png jams.png

REPORT is a folder that `robosim evaluate --report` wrote; its episodes are run again. The minutes shown are
those in which the longest clog of a team begins, or the first ones.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.figure import Figure

from robosim.analysis.figures.plots import draw_flow
from robosim.analysis.figures.rendering import palette_png
from robosim.analysis.figures.spacetime import draw_panel
from robosim.analysis.figures.spans import Span, longest_clog
from robosim.analysis.figures.style import look, time_unit
from robosim.analysis.measure.metrics import clogged_share, pellets, summarise
from robosim.analysis.measure.monitor import Episode, EpisodeMonitor
from robosim.episodes.replay import begun
from robosim.episodes.trajectory import load_trajectory

STRIP = 300.0
"""Time shown of each team, s."""
BEFORE = 120.0
"""Of that, before its longest clog, s."""


def episodes_of(report: Path) -> tuple[str, list[Episode]]:
    """Return who drove the episodes that a report keeps, and what they were like."""
    driver, measured = "", []
    for path in sorted((report / "episodes").glob("*.npz"), key=lambda path: int(path.stem)):
        trajectory = load_trajectory(path)
        env = begun(trajectory, str(path))
        monitor = EpisodeMonitor(env.arena, env.robots)
        monitor.add(env.frame())
        for actions in trajectory.chosen:
            env.step(actions[None])
            monitor.add(env.frame())
        measured.append(monitor.finish())
        driver = trajectory.policy
    return driver, measured


def title(driver: str, episodes: list[Episode]) -> str:
    """Return who drove, and how it went."""
    summaries = {summary.metric.compute: summary for summary in summarise(episodes)}
    brought, share = summaries[pellets].defined, summaries[clogged_share].defined
    return (
        f"{driver}, {episodes[0].arena.name}, {episodes[0].robots} robots: {brought.mean():.0f} pellets "
        f"in an episode, clogged {100 * share.mean():.0f} % of the time"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("reports", type=Path, nargs="+")
    parser.add_argument("--png", type=Path, default=Path("jams.png"))
    options = parser.parse_args()
    with look():
        rows = len(options.reports)
        figure = Figure(figsize=(10.0, 0.6 + 1.75 * rows), dpi=120, layout="constrained")
        panels = figure.subplots(rows, 2, width_ratios=(3.4, 1.0), squeeze=False)
        for (left, right), report in zip(panels, options.reports, strict=True):
            driver, episodes = episodes_of(report)
            number, clog = longest_clog(episodes)
            episode = episodes[number]
            start = clog.start * episode.arena.timing.decision_period if clog else 0.0
            begin = max(0.0, min(start - BEFORE, episode.seconds - STRIP))
            draw_panel(left, episode, 0, Span(begin, begin + STRIP), time_unit(episode.seconds), near=False)
            left.set_ylabel("from home, m")
            left.set_title(title(driver, episodes), loc="left", fontsize=9)
            draw_flow(right, episodes)
            print(f"{report}: {title(driver, episodes)}", flush=True)
        for left, right in panels[:-1]:
            right.set_xlabel("")
            left.set_xlabel("")
        panels[-1][0].set_xlabel("time, min (blue: unladen, orange: laden, hatched: clog)")
        options.png.write_bytes(palette_png(figure, colours=64))


if __name__ == "__main__":
    main()
