"""What the report's page says; `templates/page.html` lays it out.

The page is one HTML file that needs nothing else, neither network nor script.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from markupsafe import Markup

import robosim
from robosim.analysis.clogs.clog import TRANSITS, Clog
from robosim.analysis.figures.catalogue import FIGURES, Plot
from robosim.analysis.figures.rendering import Rendered
from robosim.analysis.figures.style import COLUMN
from robosim.analysis.measure.metrics import NotDefined, Summary, clogged_share, clogs, shown
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.strategy import Strategy, classify
from robosim.analysis.report.clip import Clip
from robosim.analysis.report.markup import Column, backticks_as_code, code, rendered
from robosim.analysis.report.tables import clogged_share_by_transits
from robosim.analysis.report.words import (
    clog_definition,
    mean_share,
    minutes,
    number_of,
    summary_sentences,
)
from robosim.control.card import Evaluation

_MOST_ROWS = 200
"""Longer lists are cut short on the page; the files beside it hold all."""


class _FigureOnPage(NamedTuple):
    title: str
    caption: str
    image: str
    """As a data URL."""
    is_narrow: bool


def page(
    evaluation: Evaluation,
    episodes: Sequence[Episode],
    summaries: Sequence[Summary],
    figures: Mapping[str, Rendered],
    command: str,
    clip: Clip | None = None,
) -> str:
    """Return the page; `figures` are those of `FIGURES`, by name, and `clip` is its moving picture."""
    found = [(number, clog) for number, one in enumerate(episodes) for clog in clogs(one)]
    return rendered(
        "page.html",
        title=f"{evaluation.controller} in {evaluation.arena}, {number_of(evaluation.robots, 'robot')}",
        subtitle=_run_in_short(evaluation, episodes[0]),
        tiles=_tiles(evaluation, episodes),
        summary=" ".join(summary_sentences(episodes)),
        facts=_facts(evaluation, episodes[0]),
        command=command,
        figures=[_figure(plot, figures[plot.name]) for plot in FIGURES],
        clog_definition=clog_definition(episodes[0]),
        sensitivity=_sensitivity_table(episodes) if episodes[0].tunnels.count else [],
        clip=clip and _in_page(clip),
        clogs=_clog_table(found, episodes[0].arena.timing.decision_period),
        clog_count=len(found),
        metrics=_metric_table(summaries),
        episodes=_episode_table(episodes[:_MOST_ROWS]),
        episode_count=len(episodes),
        files=[
            Column("in this folder", [code(name) for name in _FILES]),
            Column("what it holds", list(_FILES.values())),
        ],
        version=robosim.__version__,
    )


_FILES = {
    "figures/": "every figure as PNG and SVG",
    "metrics.json": "all metrics of each episode, clogs, strategies, the evaluation",
    "trips.parquet": "a row for each trip",
    "clogs.parquet": "a row for each clog",
    "visits.parquet": "a row for each visit of a robot to a tunnel",
    "flow.parquet": "flow and density of each tunnel, a row for each 30 s",
    "episodes/": "seed and actions of each episode",
}


def _run_in_short(evaluation: Evaluation, episode: Episode) -> str:
    return (
        f"{number_of(evaluation.episodes, 'episode')} of {number_of(evaluation.episode_steps, 'decision')}, "
        f"{minutes(episode.seconds)} each; seed {evaluation.seed}"
    )


def _tiles(evaluation: Evaluation, episodes: Sequence[Episode]) -> list[tuple[str, str]]:
    """Return the main results: what is written large, and what it is."""
    spread = f" ± {evaluation.std:.1f}" if evaluation.episodes > 1 else ""
    count = sum(len(clogs(one)) for one in episodes)
    seen = {classify(one).strategy for one in episodes}
    strategy, about = "mixed", "strategies"
    if len(seen) == 1:
        strategy, about = seen.pop().value, "is the strategy"
        if strategy == Strategy.NEITHER.value:
            about = f"{Strategy.ONE_AT_A_TIME.value} nor {Strategy.BUCKET_BRIGADE.value}"
    tiles = [(f"{evaluation.mean:.1f}{spread}", "pellets in an episode")]
    if episodes[0].tunnels.count:
        tiles.append((mean_share([clogged_share(one) for one in episodes]), "of the time clogged"))
        tiles.append(
            (str(count), f"{'clog' if count == 1 else 'clogs'} in {number_of(len(episodes), 'episode')}")
        )
    tiles.append((strategy, about))
    return tiles


def _facts(evaluation: Evaluation, episode: Episode) -> dict[str, object]:
    return {
        "controller": evaluation.controller,
        "arena": evaluation.arena,
        "world": evaluation.world,
        "tunnels": ", ".join(f"{length:.3g} m" for length in episode.tunnels.length) or "none",
        "robots": evaluation.robots,
        **{group.name: group.words() for group in evaluation.by_group},
        "episodes": evaluation.episodes,
        "decisions in each": f"{evaluation.episode_steps}, every {episode.arena.timing.decision_period:g} s",
        "seed": evaluation.seed,
        **({} if evaluation.profile is None else {"profile": evaluation.profile.called}),
    }


def _figure(plot: Plot, files: Rendered) -> _FigureOnPage:
    """Put the smaller of a figure's files into the page itself."""
    kind, data = ("svg+xml", files.svg) if len(files.svg) <= len(files.png) else ("png", files.png)
    image = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return _FigureOnPage(plot.title, plot.caption, image, files.width <= COLUMN)


def _in_page(clip: Clip) -> _FigureOnPage:
    image = f"data:image/webp;base64,{base64.b64encode(clip.image).decode()}"
    return _FigureOnPage("The longest clog", clip.caption, image, False)


def _sensitivity_table(episodes: Sequence[Episode]) -> list[Column]:
    shares = clogged_share_by_transits(episodes)
    first = episodes[0].tunnels.transit_time
    seconds = [
        " or ".join(f"{k * time:.1f}" for time in sorted(set(first.round(2).tolist()))) for k in shares
    ]
    counts = [sum(len(clogs(one, k)) for one in episodes) for k in shares]
    return [
        Column("k, transit times", [f"{k:g}" + (" *" if k == TRANSITS else "") for k in shares], True),
        Column("longer than, s", seconds, True),
        Column("clogs", [str(count) for count in counts], True),
        Column("time clogged", [mean_share([share]) for share in shares.values()], True),
    ]


def _clog_table(found: Sequence[tuple[int, Clog]], period: float) -> list[Column]:
    """Return a row for each clog of `found`, episode and clog; the longest first, as far as there is room."""
    listed = sorted(found, key=lambda pair: pair[1].start - pair[1].end)[:_MOST_ROWS]
    return [
        Column("episode", [str(number) for number, _ in listed], True),
        Column("from", [_clock(clog.start * period) for _, clog in listed], True),
        Column("lasted, s", [f"{(clog.end - clog.start) * period:.1f}" for _, clog in listed], True),
        Column("tunnel", [str(clog.tunnel) for _, clog in listed], True),
        Column("from home, m", [f"{clog.distance:.2f}" for _, clog in listed], True),
        Column("at x, y, m", ["{:.2f}, {:.2f}".format(*clog.place) for _, clog in listed], True),
        Column("robots", [", ".join(map(str, clog.members)) for _, clog in listed]),
        Column("cause", [clog.cause.value for _, clog in listed]),
        Column("ended by", [clog.ending.value for _, clog in listed]),
    ]


def _metric_table(summaries: Sequence[Summary]) -> list[Column]:
    metrics = [summary.metric for summary in summaries]
    stds = ["" if isinstance(summary.std, NotDefined) else shown(summary.std) for summary in summaries]
    return [
        Column("metric", [metric.name for metric in metrics]),
        Column("mean", [_mean(summary) for summary in summaries], True),
        Column("std", stds, True),
        Column("n", [str(len(summary.defined)) for summary in summaries], True),
        Column("unit", [metric.unit for metric in metrics]),
        Column("what it is", [backticks_as_code(metric.definition) for metric in metrics]),
    ]


def _mean(summary: Summary) -> str:
    words = shown(summary.mean)
    return Markup("<i>{}</i>").format(words) if isinstance(summary.mean, NotDefined) else words


def _episode_table(episodes: Sequence[Episode]) -> list[Column]:
    commands = [f"robosim play episodes/{number}.npz --save {number}.rrd" for number in range(len(episodes))]
    strategies = [classify(one) for one in episodes]
    return [
        Column("episode", [str(number) for number in range(len(episodes))], True),
        Column("pellets", [str(int(one.totals.delivered.sum())) for one in episodes], True),
        Column("clogs", [str(len(clogs(one))) for one in episodes], True),
        Column("clogged", [mean_share([clogged_share(one)]) for one in episodes], True),
        Column("strategy", [f"{found.strategy.value}: {found.reason}" for found in strategies]),
        Column("in this folder", [code(command) for command in commands]),
    ]


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02}"
