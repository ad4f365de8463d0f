"""The report's page: one HTML file that needs nothing else, neither network nor script."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import robosim
from robosim.analysis.clogs.finder import TRANSITS, Clog
from robosim.analysis.figures.catalogue import FIGURES, Plot
from robosim.analysis.figures.style import COLUMN, Rendered
from robosim.analysis.measure.metrics import NotDefined, Summary, clogged_share, clogs, shown
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.strategy import Strategy, classify
from robosim.analysis.report.markup import STYLE, Column, code, table, text
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


def page(
    evaluation: Evaluation,
    episodes: Sequence[Episode],
    summaries: Sequence[Summary],
    figures: Mapping[str, Rendered],
    command: str,
) -> str:
    """Return the page; `figures` are those of `FIGURES`, by name."""
    title = f"{evaluation.controller} in {evaluation.arena}, {number_of(evaluation.robots, 'robot')}"
    parts = [
        f"<h1>{text(title)}</h1>",
        f'<p class="quiet">{text(_run_in_short(evaluation, episodes[0]))}</p>',
        _tiles(evaluation, episodes),
        f"<p>{text(' '.join(summary_sentences(episodes)))}</p>",
        _about(evaluation, episodes[0], command),
        "<h2>Figures</h2>",
        '<p class="quiet">The folder <code>figures</code> holds each as PNG and as SVG.</p>',
        f'<div class="figures">{"".join(_figure(plot, figures[plot.name]) for plot in FIGURES)}</div>',
        "<h2>Clogs</h2>",
        _clog_part(episodes),
        "<h2>Metrics</h2>",
        _metric_table(summaries),
        "<h2>Episodes, to be played again</h2>",
        _episode_part(episodes),
        "<h2>Files</h2>",
        _file_table(),
        f'<p class="quiet">Made by robosim {text(robosim.__version__)}.</p>',
    ]
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
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


def _tiles(evaluation: Evaluation, episodes: Sequence[Episode]) -> str:
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
        tiles.append((str(count), f"clogs in {number_of(len(episodes), 'episode')}"))
    tiles.append((strategy, about))
    boxes = "".join(f"<div><b>{text(value)}</b><span>{text(name)}</span></div>" for value, name in tiles)
    return f'<div class="tiles">{boxes}</div>'


def _about(evaluation: Evaluation, episode: Episode, command: str) -> str:
    tunnels = ", ".join(f"{length:.3g} m" for length in episode.tunnels.length) or "none"
    rows = {
        "controller": evaluation.controller,
        "arena": evaluation.arena,
        "tunnels": tunnels,
        "robots": evaluation.robots,
        "episodes": evaluation.episodes,
        "decisions in each": f"{evaluation.episode_steps}, every {episode.arena.timing.decision_period:g} s",
        "seed": evaluation.seed,
    }
    pairs = "".join(f"<dt>{text(name)}</dt><dd>{text(value)}</dd>" for name, value in rows.items())
    shown_command = f"<pre><code>{text(command)}</code></pre>"
    return f"<dl>{pairs}</dl>\n<p>The command that made this report:</p>\n{shown_command}"


def _figure(plot: Plot, files: Rendered) -> str:
    kind, data = ("svg+xml", files.svg) if len(files.svg) <= len(files.png) else ("png", files.png)
    image = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    narrow = ' class="narrow"' if files.width <= COLUMN else ""
    return (
        f"<figure{narrow}><h3>{text(plot.title)}</h3>"
        f'<img src="{image}" alt="{text(plot.title)}">'
        f"<figcaption>{text(plot.caption)}</figcaption></figure>"
    )


def _clog_part(episodes: Sequence[Episode]) -> str:
    parts = [f"<p>{text(clog_definition(episodes[0]))}</p>"]
    if episodes[0].tunnels.count:
        parts.append(_sensitivity_table(episodes))
    found = [(number, clog) for number, one in enumerate(episodes) for clog in clogs(one)]
    if not found:
        return "\n".join([*parts, "<p>There were none.</p>"])
    listed = sorted(found, key=lambda pair: pair[1].start - pair[1].end)[:_MOST_ROWS]
    if len(listed) < len(found):
        parts.append(
            f"<p>The {len(listed)} longest of {len(found)}; <code>clogs.parquet</code> holds all.</p>"
        )
    else:
        parts.append("<p>The longest first:</p>")
    return "\n".join([*parts, _clog_table(listed, episodes[0].arena.timing.decision_period)])


def _sensitivity_table(episodes: Sequence[Episode]) -> str:
    shares = clogged_share_by_transits(episodes)
    first = episodes[0].tunnels.transit_time
    seconds = [
        " or ".join(f"{k * time:.1f}" for time in sorted(set(first.round(2).tolist()))) for k in shares
    ]
    counts = [sum(len(clogs(one, k)) for one in episodes) for k in shares]
    listed = table(
        [
            Column("k, transit times", [f"{k:g}" + (" *" if k == TRANSITS else "") for k in shares], True),
            Column("longer than, s", seconds, True),
            Column("clogs", [str(count) for count in counts], True),
            Column("time clogged", [mean_share([share]) for share in shares.values()], True),
        ],
        small=True,
    )
    return (
        "<p>How much the share of time clogged hangs on k; the row with the star is what counts everywhere "
        f"else in this report:</p>\n{listed}"
    )


def _clog_table(found: Sequence[tuple[int, Clog]], period: float) -> str:
    return table(
        [
            Column("episode", [str(number) for number, _ in found], True),
            Column("from", [_clock(clog.start * period) for _, clog in found], True),
            Column("lasted, s", [f"{(clog.end - clog.start) * period:.1f}" for _, clog in found], True),
            Column("tunnel", [str(clog.tunnel) for _, clog in found], True),
            Column("from home, m", [f"{clog.distance:.2f}" for _, clog in found], True),
            Column("at x, y, m", ["{:.2f}, {:.2f}".format(*clog.place) for _, clog in found], True),
            Column("robots", [", ".join(map(str, clog.members)) for _, clog in found]),
            Column("cause", [text(clog.cause.value) for _, clog in found]),
            Column("ended by", [text(clog.ending.value) for _, clog in found]),
        ]
    )


def _metric_table(summaries: Sequence[Summary]) -> str:
    metrics = [summary.metric for summary in summaries]
    stds = ["" if isinstance(summary.std, NotDefined) else shown(summary.std) for summary in summaries]
    listed = table(
        [
            Column("metric", [text(metric.name) for metric in metrics]),
            Column("mean", [_mean(summary) for summary in summaries], True),
            Column("std", stds, True),
            Column("n", [str(len(summary.defined)) for summary in summaries], True),
            Column("unit", [text(metric.unit) for metric in metrics]),
            Column("what it is", [code(metric.definition) for metric in metrics]),
        ]
    )
    return (
        "<p>Mean and standard deviation (std, with n - 1) between the n episodes in which a metric is "
        f"defined; shares are out of 1.</p>\n{listed}"
    )


def _mean(summary: Summary) -> str:
    words = text(shown(summary.mean))
    return f"<i>{words}</i>" if isinstance(summary.mean, NotDefined) else words


def _episode_part(episodes: Sequence[Episode]) -> str:
    listed = episodes[:_MOST_ROWS]
    commands = [f"robosim play episodes/{number}.npz --save {number}.rrd" for number in range(len(listed))]
    shares = [clogged_share(one) for one in listed]
    commands_of = table(
        [
            Column("episode", [str(number) for number in range(len(listed))], True),
            Column("pellets", [str(int(one.totals.delivered.sum())) for one in listed], True),
            Column("clogs", [str(len(clogs(one))) for one in listed], True),
            Column("clogged", [mean_share([one]) for one in shares], True),
            Column(
                "strategy",
                [f"{text(found.strategy.value)}: {text(found.reason)}" for found in map(classify, listed)],
            ),
            Column("in this folder", [f"<code>{text(command)}</code>" for command in commands]),
        ]
    )
    rest = f"<p>The first {len(listed)} of {len(episodes)}.</p>\n" if len(listed) < len(episodes) else ""
    return (
        "<p>Each is stored as seed and actions, and runs again to the last bit: the command writes a "
        "recording with everything that happened, and <code>rerun 0.rrd</code> opens it.</p>\n"
        f"{rest}{commands_of}"
    )


def _file_table() -> str:
    names = [f"<code>{name}</code>" for name in _FILES]
    return table(
        [Column("in this folder", names), Column("what it holds", list(_FILES.values()))], small=True
    )


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02}"
