"""Clogs in recordings: what is drawn and logged is what the finder of clogs says."""

import tracemalloc
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from robosim.analysis.clogs.clog import Cause, Clog, Ending, clogs_among
from robosim.analysis.clogs.finder import ClogFinder
from robosim.analysis.measure.traffic import TrafficMeter
from robosim.analysis.measure.tunnels import find_tunnels
from robosim.arena import load_arena
from robosim.cli.main import main
from robosim.control.protocols import ActiveController
from robosim.envs.vector import VectorEnv
from robosim.episodes.columns import FrameColumns
from robosim.episodes.replay import replay
from robosim.playback import clogs as clogs_module
from robosim.playback import palette, recording
from robosim.playback.clogs import ClogWatch, Drawn, NumberedClog, Settled, decisions_until_certain
from robosim.playback.clogwriter import LINK_GRID, ClogWriter
from robosim.playback.episode import (
    decisions_run,
    record_trajectory,
    spans_around,
    watch_episode,
    watch_trajectory,
    widened,
)
from tests.playback.reading import Reading, plain

WEST, NORTH, STOP = 2, 0, 4
STEPS = 400
PERIOD = 0.3
HOLD = 10


class Run:
    """A run, and what the finder says of it, all decisions at once."""

    def __init__(self, trajectory, arena):
        self.trajectory, self.arena, self.robots = trajectory, arena, trajectory.robots
        self.steps = len(trajectory.chosen)
        self.frames = [deepcopy(frame) for frame in replay(trajectory)]
        tunnels = find_tunnels(arena)
        columns = FrameColumns(
            self.robots, arena.pellets.count, (arena.rows, arena.columns), len(self.frames)
        )
        for frame in self.frames:
            columns.add(frame)
        self.place = columns.pose[:, :, :2].copy()
        distance = tunnels.distance_to_home(self.place)
        traffic, finder = (kind(arena, self.robots, tunnels) for kind in (TrafficMeter, ClogFinder))
        finder.add(columns, distance, traffic.add(columns, distance))
        self.groups = finder.groups
        self.clogs = clogs_among(finder.finish())

    def rings(self, reading, steps):
        """[steps, robots] whether the viewer shows a ring."""
        return np.array(
            [
                [bool(strips) for strips in _shown(reading, f"/arena/robots/{robot}/clog", STRIPS, steps)]
                for robot in range(self.robots)
            ]
        ).T


STRIPS = "LineStrips2D:strips"


def _shown(reading, path, name, steps):
    """What the viewer shows after each of `steps`; nothing before the first row."""
    if path not in reading.rows:
        return [[]] * len(steps)
    rows = reading.rows[path]
    latest = np.searchsorted(rows["step"], steps, side="right") - 1
    return [rows[name][index] if index >= 0 else [] for index in latest]


def _head_on():
    """Two robots meet in a lane for one; one backs off, lets the other by, and they meet again."""
    env = VectorEnv("single-lane", robots=2, seed=0, episode_steps=STEPS, autoreset=False)
    controller, tunnels = ActiveController(), find_tunnels(env.arena)
    observation = env.reset()
    controller.reset(env)
    came = None
    while env.steps_taken < STEPS:
        actions = controller.act(env, observation)
        frame = env.frame()
        middle = tunnels.home_end[0] + 0.5 * tunnels.length[0]
        if came is None:
            near = tunnels.distance_to_home(frame.pose[:, :2])[0] < middle + 0.5
            came = env.steps_taken if frame.laden[0] and near else None
            actions[0, 1] = STOP
        elif 100 < env.steps_taken - came <= 145:
            actions[0, 1] = WEST if env.steps_taken - came <= 130 else NORTH
        observation = env.step(actions).observation
    return Run(env.trajectory(policy="script"), env.arena)


@pytest.fixture(scope="module")
def jam():
    run = _head_on()
    assert [(clog.cause, clog.ending, clog.members) for clog in run.clogs] == [
        (Cause.HEAD_ON, Ending.BACKED_OFF, (0, 1)),
        (Cause.HEAD_ON, Ending.RUN_ENDED, (0, 1)),
    ]
    return run


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, jam):
    path = tmp_path_factory.mktemp("clogs") / "run.rrd"
    record_trajectory(jam.trajectory, path)
    return Reading(path)


@pytest.fixture(scope="module")
def crowd():
    """Ten robots that always go, in a lane for one: clogs that grow, shrink and pause."""
    env = VectorEnv("single-lane", robots=10, seed=0, episode_steps=420, autoreset=False)
    controller = ActiveController()
    observation = env.reset()
    controller.reset(env)
    while env.steps_taken < env.episode_steps:
        observation = env.step(controller.act(env, observation)).observation
    run = Run(env.trajectory(), env.arena)
    assert len(run.clogs) >= 2
    assert max(len(clog.members) for clog in run.clogs) > 4
    return run


@pytest.fixture(scope="module")
def crowded(tmp_path_factory, crowd):
    path = tmp_path_factory.mktemp("crowd") / "run.rrd"
    record_trajectory(crowd.trajectory, path)
    return Reading(path)


def test_entities_of_clogs_are_the_documented_ones(recorded):
    assert {entity for entity in recorded.rows if "clog" in entity} == {
        "/arena/clogs",
        "/arena/robots/0/clog",
        "/arena/robots/1/clog",
        "/modes/clogs",
        "/log/clogs",
    }


def test_a_clog_is_an_interval_that_says_cause_and_robots(jam, recorded):
    first, second = jam.clogs
    lane = recorded.rows["/modes/clogs"]
    assert lane["step"].tolist() == [first.start, first.end, second.start], "the last is not over"
    assert lane["StateChange:state"] == [["head-on: 0, 1"], [], ["head-on: 0, 1"]]
    assert lane["sim_time"] == pytest.approx(lane["step"] * PERIOD)
    style = recorded.static["/modes/clogs"]
    assert style["StateConfiguration:values"] == ["head-on: 0, 1"]
    assert style["StateConfiguration:colors"] == [_rgba(palette.CAUSES[Cause.HEAD_ON])]
    assert "/modes/clogs_2" not in recorded.rows


def test_a_clog_has_a_line_where_it_begins_and_one_where_it_is_over(jam, recorded):
    first, second = jam.clogs
    rows = recorded.rows["/log/clogs"]
    assert rows["step"].tolist() == [first.start, first.end, second.start]
    assert rows["sim_time"] == pytest.approx(rows["step"] * PERIOD)
    places = [f"({clog.place[0]:.2f}, {clog.place[1]:.2f}) m" for clog in jam.clogs]
    seconds = [round((clog.end - clog.start) * PERIOD) for clog in jam.clogs]
    assert rows["TextLog:text"] == [
        [f"clog 1: head-on, robots 0, 1, at {places[0]}, {seconds[0]} s, ended: one backed off"],
        [f"clog 1 is over after {seconds[0]} s: one backed off"],
        [f"clog 2: head-on, robots 0, 1, at {places[1]}, {seconds[1]} s, not over at the end"],
    ]


def test_rings_are_shown_from_the_start_of_a_clog_to_its_end_and_nowhere_else(jam, recorded):
    steps = np.arange(STEPS + 1)
    standing = np.zeros(STEPS + 1, dtype=bool)
    for clog in jam.clogs:
        standing[clog.start : clog.end] = True
    rings = jam.rings(recorded, steps)
    assert rings.tolist() == np.stack([standing, standing], axis=1).tolist()
    for robot in range(2):
        assert len(recorded.rows[f"/arena/robots/{robot}/clog"]["step"]) == 3


def test_links_join_the_robots_and_are_written_only_when_they_move(jam, recorded):
    rows = recorded.rows["/arena/clogs"]
    steps = np.arange(STEPS + 1)
    for step, strips, pair in zip(
        steps,
        _shown(recorded, "/arena/clogs", STRIPS, steps),
        _shown(recorded, "/arena/clogs", "linked", steps),
        strict=True,
    ):
        clog = next((clog for clog in jam.clogs if clog.start <= step < clog.end), None)
        # Before they are recognised, the robots are linked as then.
        linked = clog is not None and (jam.groups.link[step, 0, 1] or step < clog.start + HOLD)
        assert len(strips) == linked
        if linked:
            assert np.abs(np.array(strips[0]) - jam.place[step]).max() <= LINK_GRID * 1.01
            assert pair == [0, 1]
    assert len(rows["step"]) < 0.2 * sum(clog.end - clog.start for clog in jam.clogs)


def test_in_a_crowd_exactly_the_members_are_ringed_and_linked_as_found(crowd, crowded):
    steps = np.arange(crowd.steps + 1)
    rings = crowd.rings(crowded, steps)
    expected = np.zeros_like(rings)
    for clog in crowd.clogs:
        rows = slice(clog.start, clog.end)
        members = list(clog.members)
        assert rings[rows][:, members].any(axis=1).all(), "somebody stands in it at any time"
        assert rings[rows][:, members].any(axis=0).all(), "every member does at some time"
        expected[rows, members] |= crowd.groups.label[rows, members] >= 0
        # Who is ringed and not in a group came to a halt just then, or pauses.
        for robot in members:
            for step in range(clog.start, clog.end):
                if rings[step, robot] and not expected[step, robot]:
                    near = crowd.groups.label[max(0, step - HOLD) : step + HOLD + 1, robot]
                    assert (near >= 0).any()
    assert not (expected & ~rings).any()
    allowed = np.zeros_like(rings)
    for clog in crowd.clogs:
        allowed[clog.start : clog.end, list(clog.members)] = True
    assert not (rings & ~allowed).any()
    for step, strips, pairs in zip(
        steps,
        _shown(crowded, "/arena/clogs", STRIPS, steps),
        _shown(crowded, "/arena/clogs", "linked", steps),
        strict=True,
    ):
        found = {tuple(pair) for pair in np.array(pairs, dtype=int).reshape(-1, 2).tolist()}
        assert len(found) == len(strips)
        assert all(rings[step, one] and rings[step, other] for one, other in found)
        one, other = np.nonzero(np.triu(crowd.groups.link[step] & rings[step] & rings[step][:, None]))
        assert found >= set(zip(one.tolist(), other.tolist(), strict=True))
        for pair, strip in zip(sorted(found), strips, strict=True):
            assert np.abs(np.array(strip) - crowd.place[step, list(pair)]).max() <= LINK_GRID * 1.01
    assert crowded.rows["/modes/clogs"]["step"][0] == crowd.clogs[0].start


@pytest.mark.parametrize("chunk", [1, 7, 64])
def test_the_end_of_a_chunk_changes_nothing(tmp_path, monkeypatch, crowd, crowded, chunk):
    monkeypatch.setattr(clogs_module, "CHUNK", chunk)
    path = tmp_path / "run.rrd"
    record_trajectory(crowd.trajectory, path)
    found = Reading(path)
    assert found.rows.keys() == crowded.rows.keys()
    for entity, rows in found.rows.items():
        if "clogs" in entity or entity.endswith("/clog"):
            assert plain(rows) == plain(crowded.rows[entity]), entity
    assert found.static["/modes/clogs"] == crowded.static["/modes/clogs"]


def test_in_a_recording_of_parts_clogs_are_those_of_the_whole(tmp_path, jam, recorded):
    first, second = jam.clogs
    spans = [(first.start + 20, first.end + 5), (second.start - 15, second.start + 30)]
    path = tmp_path / "run.rrd"
    done = record_trajectory(jam.trajectory, path, spans=spans)
    kept = widened(spans, STEPS)
    assert done.decisions == decisions_run(spans, STEPS, jam.arena) < STEPS
    assert done.decisions == kept[-1][1] - 1 + decisions_until_certain(jam.arena)
    found = Reading(path)
    steps = np.concatenate([np.arange(start, end) for start, end in kept])
    assert (jam.rings(found, steps) == jam.rings(recorded, steps)).all()
    for entity in ("/arena/clogs", "/arena/robots/0/clog"):
        assert set(found.rows[entity]["step"]) <= set(steps)
    lane = found.rows["/modes/clogs"]
    assert lane["step"].tolist() == [kept[0][0], first.end, second.start, kept[1][1]]
    assert lane["StateChange:state"] == [["head-on: 0, 1"], [], ["head-on: 0, 1"], []]
    log = found.rows["/log/clogs"]
    assert log["step"].tolist() == [first.end, second.start], "the start of the first is not recorded"
    assert log["TextLog:text"][1][0].startswith("clog 2: head-on, robots 0, 1, ")


def test_the_end_of_the_last_part_does_not_hide_how_its_clog_ends(tmp_path, jam, recorded):
    first = jam.clogs[0]
    path = tmp_path / "run.rrd"
    record_trajectory(jam.trajectory, path, spans=[(first.start, first.end)])
    assert Reading(path).rows["/log/clogs"]["TextLog:text"] == recorded.rows["/log/clogs"]["TextLog:text"][:2]


def test_where_frames_are_left_out_a_clog_ends(tmp_path, jam):
    first, second = jam.clogs
    path = tmp_path / "run.rrd"
    with recording(path, jam.arena, robots=2) as recorder:
        for frame in jam.frames:
            if not first.start + 70 <= frame.step < second.start - 15:
                recorder.add(frame)
            elif frame.step == first.start + 70:
                recorder.pause()
    found = Reading(path)
    lane = found.rows["/modes/clogs"]
    assert lane["step"].tolist() == [first.start, first.start + 70, second.start]
    lines = [text[0] for text in found.rows["/log/clogs"]["TextLog:text"]]
    assert lines[0].endswith("21 s, not over at the end")
    assert lines[1].startswith("clog 2: ")


def test_a_run_without_a_clog_has_no_mark_of_one(tmp_path, jam):
    path = tmp_path / "run.rrd"
    record_trajectory(replace(jam.trajectory, chosen=jam.trajectory.chosen[:75]), path)
    assert not [entity for entity in Reading(path).rows if "clog" in entity]


def test_an_interrupted_run_shows_the_clog_so_far(tmp_path, jam):
    first = jam.clogs[0]

    def interrupt(step, delivered):
        if step == first.start + 70:
            raise KeyboardInterrupt

    path = tmp_path / "run.rrd"
    record_trajectory(jam.trajectory, path, on_step=interrupt)
    found = Reading(path)
    assert found.rows["/modes/clogs"]["step"].tolist() == [first.start]
    assert found.rows["/arena/robots/1/clog"]["step"].tolist() == [first.start]
    assert found.rows["/log/clogs"]["TextLog:text"][0][0].endswith(" s, not over at the end")


def _numbered(number, start, end, members, cause=Cause.QUEUE):
    clog = Clog(0, start, end, members, cause, Ending.WENT_ON, (1.0, 0.5), 0.4, 3.0)
    return NumberedClog(number, clog, [(start, end)])


def test_clogs_at_the_same_time_lie_in_lanes_of_their_own(tmp_path, jam):
    path = tmp_path / "run.rrd"
    drawn = Drawn(np.zeros(0, int), np.zeros((0, 4, 2)), np.zeros((0, 4), bool), np.zeros((0, 4, 4), bool))
    numbered = [
        _numbered(1, 10, 200, (0, 1)),
        _numbered(2, 50, 100, (2,), Cause.PELLET),
        _numbered(3, 100, 300, (2, 3), Cause.TURNING),
        _numbered(4, 200, 250, (0, 1)),
    ]
    with recording(path, jam.arena, robots=4) as recorder:
        writer = ClogWriter(recorder._clog_writer._stream, jam.arena, 4)
        for one in numbered:
            writer.write(Settled(drawn, [one], 1000))
        writer.finish()
    found = Reading(path)
    lane, second = found.rows["/modes/clogs"], found.rows["/modes/clogs_2"]
    # Where one begins as another ends, the row of the beginning comes later, and counts.
    assert lane["step"].tolist() == [10, 200, 200, 250]
    assert lane["StateChange:state"] == [["queue: 0, 1"], [], ["queue: 0, 1"], []]
    assert second["step"].tolist() == [50, 100, 100, 300]
    assert second["StateChange:state"] == [["blocked by a pellet: 2"], [], ["turning: 2, 3"], []]
    style = found.static["/modes/clogs_2"]
    assert style["StateConfiguration:values"] == ["blocked by a pellet: 2", "turning: 2, 3"]
    assert style["StateConfiguration:colors"] == [
        _rgba(palette.CAUSES[cause]) for cause in (Cause.PELLET, Cause.TURNING)
    ]
    assert "robot 2, at" in found.rows["/log/clogs"]["TextLog:text"][1][0]


def test_memory_does_not_grow_with_the_run(monkeypatch, crowd):
    monkeypatch.setattr(clogs_module, "CHUNK", 100)
    watch = ClogWatch(crowd.arena, crowd.robots, lambda settled: None)
    used, step = [], 0
    tracemalloc.start()
    try:
        for _ in range(8):
            for frame in crowd.frames:
                watch.add(replace(frame, step=step, time=step * PERIOD), recorded=True)
                step += 1
            used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # The visits alone would come to twice as much.
    assert used[-1] < used[1] + 20_000


def test_colours_of_causes_differ():
    colours = [palette.CAUSES[cause] for cause in Cause]
    others = [style.colour for style in palette.MODES.values()]
    for index, colour in enumerate(colours):
        for other in [*colours[:index], *others]:
            assert np.abs(np.subtract(colour, other)).sum() > 60
    assert palette.CLOG in palette.legend(load_arena("paper").team(1))
    assert palette.legend(load_arena("relay").team(2))[-1].label == "transporters"


def test_watching_finds_the_clogs_of_a_run(jam):
    heard = []
    found = watch_trajectory(jam.trajectory, on_step=lambda step, delivered: heard.append(step))
    assert found.clogs == jam.clogs
    assert found.arena.text == jam.arena.text
    assert heard == list(range(1, STEPS + 1))


def test_spans_around_clogs_reach_as_far_as_asked(jam):
    first, second = jam.clogs
    assert spans_around(jam.clogs, 6.0, jam.arena) == [
        (first.start - 20, first.end + 21),
        (second.start - 20, second.end + 21),
    ]
    early = first._replace(start=4)
    assert spans_around([early], 6.0, jam.arena) == [(0, first.end + 21)]


@pytest.fixture(scope="module")
def saved(tmp_path_factory, jam):
    path = tmp_path_factory.mktemp("saved") / "run.npz"
    jam.trajectory.save(path)
    return path


def test_clogs_only_records_the_clogs_and_what_is_around_them(tmp_path, capsys, jam, saved, recorded):
    path = tmp_path / "clogs.rrd"
    assert main(["play", str(saved), "--clogs-only", "--save", str(path)]) == 0
    printed = capsys.readouterr().out
    spans = widened([(clog.start - 17, clog.end + 18) for clog in jam.clogs], STEPS)
    assert len(spans) == 2
    kept = sum(end - start for start, end in spans)
    assert f"{path}: 2 clogs, {kept} of {STEPS} decisions, " in printed
    assert f"watching step {STEPS}/{STEPS}  " in printed
    assert f"recording step {STEPS}/{STEPS}  " in printed
    found = Reading(path)
    steps = np.concatenate([np.arange(start, end) for start, end in spans])
    tracks = set(found.rows["/arena/tracks"]["step"])
    assert tracks <= set(steps)
    assert {start for start, _ in spans} <= tracks
    for entity in ("/modes/clogs", "/log/clogs", "/arena/clogs", "/arena/robots/0/clog"):
        assert plain(found.rows[entity]) == plain(recorded.rows[entity]), entity
    about = found.static["/__properties/robosim"]
    assert about["recorded"] == ["2 clogs, and 5 s before and after each"]
    assert about["policy"] == ["script"]


def test_a_viewer_is_shown_meanwhile_what_a_recording_says_of_clogs_at_the_end(tmp_path, jam, recorded):
    path = tmp_path / "shown.rrd"
    with recording(path, jam.arena, robots=2) as recorder:
        for frame in replay(jam.trajectory):
            recorder.add(frame)
            if frame.step % 37 == 0:
                recorder.show()
    shown = Reading(path)
    for entity in ("/modes/clogs", "/log/clogs", "/arena/clogs", "/arena/robots/0/clog"):
        assert plain(shown.rows[entity]) == plain(recorded.rows[entity]), entity
    assert shown.static["/modes/clogs"] == recorded.static["/modes/clogs"]


def test_clogs_only_runs_a_policy_twice(tmp_path, capsys):
    path, run = tmp_path / "clogs.rrd", tmp_path / "run.npz"
    command = ["play", "active", "--arena", "single-lane", "--robots", "10", "--steps", "150"]
    options = ["--clogs-only", "--around", "1.5", "--save", str(path), "--save-trajectory", str(run)]
    assert main([*command, *options]) == 0
    env = VectorEnv("single-lane", robots=10, seed=0, episode_steps=150, autoreset=False)
    clogs = watch_episode(ActiveController(), env).clogs
    assert len(clogs) > 0
    printed = capsys.readouterr().out
    number = "1 clog" if len(clogs) == 1 else f"{len(clogs)} clogs"
    spans = widened(spans_around(clogs, 1.5, env.arena), 150)
    assert f"{path}: {number}, {sum(end - start for start, end in spans)} of 150 decisions, " in printed
    assert f"robosim play {run}\n" in printed
    found = Reading(path)
    lines = [text[0] for text in found.rows["/log/clogs"]["TextLog:text"]]
    assert len([line for line in lines if ": " in line and " is over " not in line]) == len(clogs)
    about = found.static["/__properties/robosim"]
    assert (about["policy"], about["seed"]) == (["active"], ["0"])
    assert about["recorded"] == [f"{number}, and 1.5 s before and after each"]


def test_without_a_clog_there_is_a_sentence_and_no_file(tmp_path, capsys):
    path = tmp_path / "clogs.rrd"
    path.write_text("an older one")
    assert main(["play", "lanes", "--steps", "40", "--clogs-only", "--save", str(path)]) == 0
    captured = capsys.readouterr()
    last = captured.out.splitlines()[-1]
    assert last == f"No clog in 40 decisions: nothing to record, {path} was not written."
    assert captured.err == ""
    assert path.read_text() == "an older one"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--around", "2"], "--around says how much to record around clogs: it needs --clogs-only."),
        (
            ["--clogs-only", "--around", "-1"],
            "--around is -1.0, but must be a number of seconds from 0 to 1e+09.",
        ),
        (
            ["--clogs-only", "--around", "1e308"],
            "--around is 1e+308, but must be a number of seconds from 0 to 1e+09.",
        ),
        (
            ["--clogs-only", "--around", "nan"],
            "--around is nan, but must be a number of seconds from 0 to 1e+09.",
        ),
        (["--clogs-only", "--save", "run.mp4"], "Recording 'run.mp4': the file name must end in .rrd"),
        (["--clogs-only", "--save", "nowhere/run.rrd"], "Recording 'nowhere/run.rrd': cannot be written"),
    ],
)
def test_wrong_input_is_a_sentence_before_anything_runs(tmp_path, monkeypatch, capsys, options, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["play", "lanes", *options]) == 2
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def _interrupt_at(monkeypatch, calls):
    """Stand for a person who presses Ctrl-C in this decision, counted over both passes."""
    step, count = VectorEnv.step, iter(range(10**6))

    def interrupted(env, actions):
        if next(count) == calls:
            raise KeyboardInterrupt
        return step(env, actions)

    monkeypatch.setattr(VectorEnv, "step", interrupted)


def test_an_interrupt_while_watching_leaves_nothing(tmp_path, monkeypatch, capsys):
    _interrupt_at(monkeypatch, 30)
    monkeypatch.chdir(tmp_path)
    command = ["play", "lanes", "--robots", "2", "--steps", "60", "--clogs-only"]
    assert main([*command, "--save-trajectory", "run.npz"]) == 130
    assert capsys.readouterr().err == "robosim: interrupted\n"
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_while_recording_keeps_what_is_there(tmp_path, monkeypatch, capsys, jam, saved):
    first = jam.clogs[0]
    path = tmp_path / "clogs.rrd"
    stop = first.end + 30
    _interrupt_at(monkeypatch, STEPS + stop)
    assert main(["play", str(saved), "--clogs-only", "--save", str(path)]) == 130
    captured = capsys.readouterr()
    assert captured.err == "robosim: interrupted\n"
    assert f"{path}: 2 clogs, up to decision {stop}, " in captured.out
    assert Reading(path).rows["/modes/clogs"]["step"].tolist() == [first.start, first.end]


def _rgba(colour):
    red, green, blue = colour
    return (red << 24) | (green << 16) | (blue << 8) | 255
