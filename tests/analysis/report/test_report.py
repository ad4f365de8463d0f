"""The report's folder: a page that stands alone, tables that equal what was measured, whole or not at all."""

import base64
import functools
import io
import json
import os
import re
import resource
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import robosim
from robosim.analysis.clogs.clog import Cause, Ending, clogged_decisions
from robosim.analysis.figures.catalogue import FIGURES
from robosim.analysis.figures.rendering import Rendered
from robosim.analysis.figures.style import COLUMN
from robosim.analysis.measure.metrics import METRICS, NotDefined, clogs, shown, summarise
from robosim.analysis.measure.monitor import TeamMonitor
from robosim.analysis.measure.strategy import classify
from robosim.analysis.report.folder import require_folder, whole_folder
from robosim.analysis.report.tables import trip_table
from robosim.analysis.report.words import congestion_lines
from robosim.analysis.report.writer import write_report
from robosim.arena import parse_arena
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.discretise.modes import Mode
from robosim.envs.render import Painter
from robosim.envs.vector import VectorEnv
from robosim.episodes.replay import replay
from robosim.episodes.trajectory import load_trajectory
from robosim.errors import InputError
from tests.analysis.figures.test_figures import COMMAND, RUNS, report, watched

DOCS = Path(__file__).parents[3] / "docs" / "report.md"
CLIP = "The longest clog"
VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Reads a page, and fails where tags do not match."""

    def __init__(self, path):
        super().__init__()
        self.open, self.tags, self.words, self.loads = [], [], [], []
        self.tables, self.images = [], []
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.tags.append(tag)
        self.loads += [values[name] for name in ("src", "href", "srcset", "data", "action") if name in values]
        if tag == "img":
            self.images.append(values)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in {"td", "th"}:
            self.tables[-1][-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.words.append(data)
        if {"td", "th"} & set(self.open):
            self.tables[-1][-1][-1] += data

    def table_with(self, heading):
        return next(table[1:] for table in self.tables if heading in table[0])


@functools.cache
def page_of(run):
    return Page(report(run) / "index.html")


def metrics_of(run):
    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads((report(run) / "metrics.json").read_text(), parse_constant=refuse)


def files_under(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def blank_figures(monkeypatch):
    """Draw nothing, which takes time, where figures do not matter."""
    blank = Rendered(b"p" * 20_000, b"<svg/>" * 2_000, COLUMN)
    monkeypatch.setattr("robosim.analysis.report.writer.draw", lambda plot, episodes: blank)


@pytest.mark.parametrize("run", RUNS)
def test_the_folder_holds_what_it_says_and_nothing_else(run):
    pictures = {f"figures/{plot.name}.{kind}" for plot in FIGURES for kind in ("png", "svg")}
    episodes = {f"episodes/{number}.npz" for number in range(len(watched(run).episodes))}
    tables = {"index.html", "metrics.json"} | {
        f"{name}.parquet" for name in ("trips", "clogs", "visits", "flow")
    }
    assert set(files_under(report(run))) == pictures | episodes | tables
    assert all(files_under(report(run)).values())


@pytest.mark.parametrize("run", RUNS)
def test_the_page_stands_alone(run):
    page, text = page_of(run), (report(run) / "index.html").read_text(encoding="utf-8")
    assert all(place.startswith("data:image/") for place in page.loads)
    assert not {"script", "link", "iframe", "object", "base", "form"} & set(page.tags)
    assert not re.search(r"https?:|@import|url\(", text)
    words = " ".join(page.words)
    assert "nan" not in words.lower()
    assert not re.search(r"\b(inf|None|NotDefined)\b", words)
    assert COMMAND in words


@pytest.mark.parametrize("run", RUNS)
def test_every_figure_is_on_the_page_in_its_smaller_file(run):
    images = [image for image in page_of(run).images if image["alt"] != CLIP]
    assert [image["alt"] for image in images] == [plot.title for plot in FIGURES]
    for plot, image in zip(FIGURES, images, strict=True):
        kind, data = image["src"].removeprefix("data:image/").split(";base64,")
        files = {
            "svg+xml": (report(run) / "figures" / f"{plot.name}.svg").read_bytes(),
            "png": (report(run) / "figures" / f"{plot.name}.png").read_bytes(),
        }
        assert base64.b64decode(data) == files[kind] == min(files.values(), key=len)


@pytest.mark.parametrize("run", RUNS)
def test_the_table_of_metrics_is_that_of_the_summaries(run):
    rows = page_of(run).table_with("what it is")
    summaries = summarise(watched(run).episodes)
    for row, summary in zip(rows, summaries, strict=True):
        metric, std = summary.metric, summary.std
        assert row == [
            metric.name,
            shown(summary.mean),
            "" if isinstance(std, NotDefined) else shown(std),
            str(len(summary.defined)),
            metric.unit,
            metric.definition.replace("`", ""),
        ]
    if run == "one robot":
        gini = next(row for row in rows if row[0].startswith("Gini"))
        assert gini[1] == "not defined: one robot has nobody to share with"


@pytest.mark.parametrize("run", RUNS)
def test_metrics_json_equals_the_summaries(run):
    record, seen = metrics_of(run), watched(run)
    assert record["evaluation"] == seen.evaluation.model_dump(mode="json")
    assert (record["command"], record["robosim"]) == (COMMAND, robosim.__version__)
    for entry, summary in zip(record["metrics"], summarise(seen.episodes), strict=True):
        assert (entry["name"], entry["unit"]) == (summary.metric.name, summary.metric.unit)
        for written, value in zip(
            [entry["mean"], entry["std"], *entry["episodes"]],
            [summary.mean, summary.std, *summary.values],
            strict=True,
        ):
            if isinstance(value, NotDefined):
                assert written == {"value": None, "reason": value.reason}
            else:
                assert written == {"value": value}
        assert entry["n"] == len(summary.defined)
    strategies = [(one["strategy"], one["reason"]) for one in record["strategy"]]
    assert strategies == [(found.strategy.value, found.reason) for found in map(classify, seen.episodes)]


def test_what_a_world_does_not_know_is_null_in_trips_parquet():
    env = VectorEnv("paper", robots=2, num_envs=1, episode_steps=150, world="grid")
    monitor = TeamMonitor()
    evaluate(make_controller("lanes"), env, 1, watch=[monitor])
    table = trip_table(monitor.episodes)
    assert table.num_rows > 2
    for name in ("impulse_Ns", "energy_J"):
        assert table[name].null_count == table.num_rows
    assert table["touches_of_robots"].null_count == 0


@pytest.mark.parametrize("run", RUNS)
def test_trips_parquet_holds_every_trip(run):
    rows = pq.read_table(report(run) / "trips.parquet").to_pylist()
    trips = [(number, trip) for number, one in enumerate(watched(run).episodes) for trip in one.trips]
    assert len(rows) == len(trips)
    for row, (number, trip) in zip(rows, trips, strict=True):
        assert row == {
            "episode": number,
            "robot": trip.robot,
            "start": trip.start,
            "end": trip.end,
            "pellets": trip.pellets,
            **{f"{mode.name.lower()}_s": trip.seconds[mode] for mode in Mode},
            "touches_of_robots": trip.contacts[0],
            "touches_of_walls": trip.contacts[1],
            "touches_of_pellets": trip.contacts[2],
            "impulse_Ns": trip.impulse,
            "energy_J": trip.energy,
        }


@pytest.mark.parametrize("run", RUNS)
def test_visits_and_flow_parquet_hold_every_visit_and_window(run):
    visits = pq.read_table(report(run) / "visits.parquet").to_pylist()
    flow = pq.read_table(report(run) / "flow.parquet").to_pylist()
    expected_visits, expected_flow = [], []
    for number, episode in enumerate(watched(run).episodes):
        for visit in episode.traffic.visits:
            ends = {-1: "nowhere", 0: "home", 1: "source"}
            expected_visits.append(
                (
                    number,
                    visit.robot,
                    visit.tunnel,
                    visit.start,
                    visit.end,
                    ends[int(visit.entered)],
                    ends[int(visit.left)],
                    visit.deepest,
                )
            )
        windows = episode.traffic.windows
        for row in range(len(windows.tunnel)):
            expected_flow.append((number, windows.tunnel[row], windows.density[row], windows.flow[row]))
    assert [tuple(row.values()) for row in visits] == expected_visits
    assert [tuple(row.values()) for row in flow] == expected_flow


@pytest.mark.parametrize("run", RUNS)
def test_clogs_parquet_the_page_and_metrics_json_hold_every_clog(run):
    rows = pq.read_table(report(run) / "clogs.parquet").to_pylist()
    found = [(number, clog) for number, one in enumerate(watched(run).episodes) for clog in clogs(one)]
    assert len(rows) == len(found)
    for row, (number, clog) in zip(rows, found, strict=True):
        assert row == {
            "episode": number,
            "tunnel": clog.tunnel,
            "start": clog.start,
            "end": clog.end,
            "start_s": clog.start * 0.3,
            "duration_s": (clog.end - clog.start) * 0.3,
            "members": list(clog.members),
            "cause": clog.cause.value,
            "ending": clog.ending.value,
            "x_m": clog.place[0],
            "y_m": clog.place[1],
            "distance_m": clog.distance,
            "transits": clog.transits,
        }
    assert metrics_of(run)["clogs"]["found"] == rows
    assert sum(metrics_of(run)["clogs"]["causes"].values()) == len(rows)
    assert sum(metrics_of(run)["clogs"]["endings"].values()) == len(rows)
    if rows:
        listed = page_of(run).table_with("ended by")
        durations = [float(row[2]) for row in listed]
        assert durations == sorted(durations, reverse=True)
        assert sorted(listed) == sorted(
            [
                str(row["episode"]),
                f"{int(row['start_s']) // 60}:{int(row['start_s']) % 60:02}",
                f"{row['duration_s']:.1f}",
                str(row["tunnel"]),
                f"{row['distance_m']:.2f}",
                f"{row['x_m']:.2f}, {row['y_m']:.2f}",
                ", ".join(map(str, row["members"])),
                row["cause"],
                row["ending"],
            ]
            for row in rows
        )


def test_the_clogged_share_is_given_for_each_k_and_falls_with_it():
    episodes = watched("clogged").episodes
    shares = metrics_of("clogged")["clogs"]["clogged_share_by_transits"]
    assert list(shares) == ["1", "2", "3", "4"]
    for k, share in shares.items():
        expected = [
            clogged_decisions(clogs(one, float(k)), one.decisions) / one.decisions for one in episodes
        ]
        assert share["value"] == pytest.approx(np.mean(expected))
    values = [share["value"] for share in shares.values()]
    assert values == sorted(values, reverse=True)
    assert values[1] > 0.0
    rows = page_of("clogged").table_with("time clogged")
    assert [row[3] for row in rows] == [f"{100 * value:.1f} %" for value in values]
    without = metrics_of("no tunnel")["clogs"]["clogged_share_by_transits"]
    assert without["2"] == {"value": None, "reason": "the arena has no tunnel"}


@pytest.mark.parametrize("run", RUNS)
def test_every_episode_is_stored_and_the_page_says_how_to_see_it(run):
    words = " ".join(page_of(run).words)
    for number, trajectory in enumerate(watched(run).trajectories):
        stored = load_trajectory(report(run) / "episodes" / f"{number}.npz")
        assert (stored.chosen == trajectory.chosen).all()
        assert (stored.seed, stored.episode, stored.config.arena) == (
            trajectory.seed,
            trajectory.episode,
            trajectory.config.arena,
        )
        assert stored.policy == watched(run).evaluation.controller
        assert f"robosim play episodes/{number}.npz --save {number}.rrd" in words


def test_the_longest_clog_is_shown_in_motion_and_small():
    (clip,) = (image for image in page_of("clogged").images if image["alt"] == CLIP)
    kind, data = clip["src"].removeprefix("data:image/").split(";base64,")
    picture = base64.b64decode(data)
    assert (kind, len(picture) < 200_000) == ("webp", True)
    seen = watched("clogged")
    number, clog = max(
        ((number, clog) for number, one in enumerate(seen.episodes) for clog in clogs(one)),
        key=lambda pair: pair[1].end - pair[1].start,
    )
    first, last = max(0, clog.start - 17), min(400, clog.end + 17)
    shown = list(replay_pictures(seen.trajectories[number], first, last, -(-(last - first + 1) // 60)))
    with Image.open(io.BytesIO(picture)) as film:
        assert film.n_frames == len(shown) <= 60
        for number in (0, len(shown) // 2, len(shown) - 1):
            film.seek(number)
            drawn = np.asarray(film.convert("RGB"), dtype=float)
            assert np.abs(drawn - shown[number]).mean() < 6.0
    assert f"from decision {first} on" in " ".join(page_of("clogged").words)
    assert CLIP not in {image["alt"] for image in page_of("still").images}


def replay_pictures(trajectory, first, last, every):
    """Yield the pictures of the decisions from `first` to `last`, both included."""
    painter = Painter(parse_arena(trajectory.config.arena, "test"), 640)
    for step, frame in enumerate(replay(trajectory)):
        if first <= step <= last and (step - first) % every == 0:
            yield painter.draw(frame)


def test_the_summary_says_in_words_what_happened():
    words = " ".join(" ".join(page_of("clogged").words).split())
    episodes = watched("clogged").episodes
    found = [clog for one in episodes for clog in clogs(one)]
    assert "A team of 12 robots delivered" in words
    assert "in 400 decisions (2 min)" in words
    totals = [int(one.totals.delivered.sum()) for one in episodes]
    assert f"{np.mean(totals):.1f} pellets on average ({min(totals)} to {max(totals)})" in words
    assert f"There w{'as 1 clog' if len(found) == 1 else f'ere {len(found)} clogs'}, in" in words
    longest = max((clog.end - clog.start) * 0.3 for clog in found)
    assert f"The longest lasted {longest:.0f} s" in words
    assert "The most frequent cause was: " in words
    assert "Strategy: " in words
    assert "One robot delivered 0 pellets in 50 decisions (15 s)." in " ".join(page_of("one robot").words)
    assert "There was no clog." in " ".join(page_of("still").words)
    assert "100.0 % of all decisions were to stop" in " ".join(page_of("still").words)
    assert "nothing could clog" in " ".join(page_of("no tunnel").words)


def test_the_command_line_s_figures():
    lines = dict(congestion_lines(watched("clogged").episodes))
    assert list(lines) == ["time clogged", "causes of clogs", "clogs ended by", "strategy"]
    assert re.fullmatch(r"\d+\.\d %, \d+ clogs?, the longest \d+ s", lines["time clogged"])
    assert dict(congestion_lines(watched("still").episodes))["time clogged"] == "0.0 %, no clogs"
    assert (
        dict(congestion_lines(watched("no tunnel").episodes))["time clogged"]
        == "not defined: the arena has no tunnel"
    )


def test_names_from_files_are_text_on_the_page(tmp_path, blank_figures):
    seen = watched("one decision")
    evil = "<b onload='x'>&\"\x1b"
    write_report(
        tmp_path / "out",
        replace(
            seen,
            evaluation=seen.evaluation.model_copy(update={"controller": evil, "arena": evil}),
            command=evil,
        ),
    )
    page = Page(tmp_path / "out" / "index.html")
    assert "b" not in page.tags[page.tags.index("dl") :]
    assert page.words.count(evil) >= 2
    assert load_trajectory(tmp_path / "out" / "episodes" / "0.npz").policy == evil.replace("\x1b", "?")


def test_an_empty_folder_that_is_there_stays_the_same_one(tmp_path, blank_figures):
    folder = tmp_path / "mounted"
    folder.mkdir()
    before = folder.stat().st_ino
    write_report(folder, watched("one decision"))
    assert folder.stat().st_ino == before
    assert set(files_under(folder)) == set(files_under(report("one decision")))
    assert [path.name for path in tmp_path.iterdir()] == ["mounted"]


def test_folders_above_are_made(tmp_path):
    require_folder(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []
    with whole_folder(tmp_path / "a" / "b") as part:
        (part / "index.html").write_text("x")
    assert (tmp_path / "a" / "b" / "index.html").read_text() == "x"
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("file", "this is a file; a report needs a folder."),
        ("full", "this folder is not empty; a report needs a new one."),
        ("file/out", "the report cannot be written: Not a directory."),
        ("x" * 300, "the report cannot be written: File name too long."),
        pytest.param(
            "locked/out",
            "the report cannot be written: Permission denied.",
            marks=pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere"),
        ),
    ],
)
def test_what_cannot_be_written_is_one_sentence_and_leaves_nothing(tmp_path, name, why):
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    (tmp_path / "locked").mkdir(mode=0o555)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as caught:
        require_folder(tmp_path / name)
    assert str(caught.value) == f"{tmp_path / name}: {why}"
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("there", [True, False])
def test_a_disk_that_is_full_leaves_nothing_behind(tmp_path, blank_figures, there):
    folder = tmp_path / "above" / "out"
    if there:
        folder.mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        # The page is the largest file, and the last.
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, limits[1]))
        with pytest.raises(InputError) as caught:
            write_report(folder, watched("one decision"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(caught.value) == f"{folder}: the report cannot be written: File too large."
    assert sorted(tmp_path.rglob("*")) == before


def test_a_trajectory_that_cannot_be_stored_names_its_place_in_the_folder(tmp_path, blank_figures):
    seen = watched("one decision")
    trajectory = replace(seen.trajectories[0], policy="two\nlines")
    with pytest.raises(InputError) as caught:
        write_report(tmp_path / "out", replace(seen, trajectories=[trajectory]))
    assert str(caught.value).startswith(f"{tmp_path}/out/episodes/0.npz: policy is ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("name", ["episodes", "index.html"])
def test_a_folder_that_fills_meanwhile_is_left_alone(tmp_path, there, name):
    folder = tmp_path / "out"
    if there:
        folder.mkdir()

    def write():
        with whole_folder(folder) as part:
            (part / "episodes").mkdir()
            (part / "index.html").write_text("ours")
            folder.mkdir(exist_ok=True)
            (folder / name).write_text("theirs")

    why = "File exists" if there else "Directory not empty"
    with pytest.raises(InputError, match=f"out: the report cannot be written: {why}."):
        write()
    assert {path.name: path.read_text() for path in folder.iterdir()} == {name: "theirs"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_docs_table_of_metrics_is_the_code_s():
    rows = ["| metric | unit | what it is |", "|---|---|---|"]
    for metric in METRICS:
        definition = metric.definition.replace("|", "\\|")
        rows.append(f"| {metric.name} | {metric.unit} | {definition} |".replace("|  |", "| |"))
    assert "\n".join(rows) in DOCS.read_text(encoding="utf-8")


def test_the_docs_name_every_figure_cause_and_ending():
    text = DOCS.read_text(encoding="utf-8")
    assert re.findall(r"^\*\*(.+)\*\* \(`([\w-]+)`\)", text, re.MULTILINE) == [
        (plot.title, plot.name) for plot in FIGURES
    ]
    for kind in (*Cause, *Ending):
        assert f"\n| {kind.value} | " in text


def test_the_docs_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = re.search(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)[1]
    exec(compile(code, "report.md", "exec"), {})
    assert (tmp_path / "second.svg").read_bytes().startswith(b"<?xml")
