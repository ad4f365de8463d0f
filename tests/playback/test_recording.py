"""Recordings read back and compared with the frames they were made of."""

import re

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rerun.components import AggregationPolicy, InterpolationMode

from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.discretise.modes import Mode
from robosim.envs.vector import VectorEnv
from robosim.episodes.columns import PHEROMONE_STEPS, ROWS
from robosim.episodes.frame import Frame
from robosim.playback import palette, recording
from robosim.playback.bodies import HEADING_GRID, POSITION_GRID, TRACK_GRID
from robosim.playback.episode import record_episode
from robosim.playback.scene import level_of_occupancy, occupancy_of_level
from robosim.playback.writer import HARD, LOG_PAUSE, REWARD_STEPS
from robosim.world.contacts import Contacts
from tests.playback.reading import Reading, plain

ROBOTS = 3
STEPS = ROWS + 150
PERIOD = 0.3


def _frames(arena):
    """Frames of no particular physics, in which everything that a recording holds changes now and then."""
    rng = np.random.default_rng(5)
    count = arena.pellets.count
    pose = rng.uniform(0.2, 1.0, (ROBOTS, 3))
    mode = np.zeros(ROBOTS, dtype=np.uint8)
    pellets = rng.uniform(0.2, 1.0, (count, 2))
    status = np.zeros(count, dtype=np.uint8)
    delivered = np.zeros(ROBOTS, dtype=np.int64)
    density = 0.0
    frames = []
    for step in range(STEPS):
        pose = pose + (rng.random(ROBOTS) < 0.6)[:, None] * rng.normal(0.0, 0.02, (ROBOTS, 3))
        mode = np.where(rng.random(ROBOTS) < 0.05, rng.integers(0, len(Mode), ROBOTS), mode).astype(np.uint8)
        pellets = pellets + (rng.random((count, 1)) < 0.01) * rng.normal(0.0, 0.0008, (count, 2))
        status = np.where(rng.random(count) < 0.002, rng.integers(0, 3, count), status).astype(np.uint8)
        delivered = delivered + (step > 0) * (rng.random(ROBOTS) < 0.01)
        density = round(rng.random(), 1) if rng.random() < 0.1 else density
        touching = int(rng.integers(0, 4)) if rng.random() < 0.3 else 0
        a = rng.integers(0, ROBOTS, touching)
        contacts = Contacts(
            env=np.zeros(touching, dtype=np.int64),
            time=np.full(touching, (step - 0.5) * PERIOD),
            kind=rng.integers(0, 3, touching).astype(np.uint8),
            a=a,
            b=(a + 1) % ROBOTS,
            position=rng.uniform(0.2, 1.0, (touching, 2)),
            impulse=rng.exponential(0.08, touching) * (rng.random(touching) < 0.9),
        )
        frames.append(
            Frame(
                step=step,
                time=step * PERIOD,
                pose=pose,
                mode=mode,
                laden=rng.random(ROBOTS) < 0.5,
                action=np.zeros(ROBOTS, dtype=np.int64),
                reward=rng.normal(size=ROBOTS).astype(np.float32),
                pellets=pellets,
                pellet_status=status,
                delivered=delivered,
                energy=np.zeros(ROBOTS),
                closest=np.full(ROBOTS, np.inf),
                density=density,
                pheromone=rng.random((arena.rows, arena.columns)),
                contacts=contacts,
            )
        )
    return frames


class Recorded(Reading):
    """The recording of `_frames`."""

    def shown(self, path, name, steps=None):
        return super().shown(path, name, np.arange(STEPS) if steps is None else steps)


@pytest.fixture(scope="module")
def arena():
    return load_arena("paper")


@pytest.fixture(scope="module")
def frames(arena):
    return _frames(arena)


@pytest.fixture(scope="module")
def file(tmp_path_factory, arena, frames):
    path = tmp_path_factory.mktemp("playback") / "run.rrd"
    with recording(path, arena, robots=ROBOTS, about={"policy": "none", "seed": "5"}) as recorder:
        for frame in frames:
            recorder.add(frame)
    return path


@pytest.fixture(scope="module")
def recorded(file):
    return Recorded(file)


def test_file_holds_one_recording_and_one_blueprint(file):
    reader = RrdReader(file)
    assert [store.application_id for store in reader.recordings()] == ["robosim"]
    assert [store.application_id for store in reader.blueprints()] == ["robosim"]


def test_entities_are_the_documented_ones(recorded):
    robots = [f"/arena/robots/{robot}" for robot in range(ROBOTS)]
    changing = {
        *robots,
        *(f"{path}/{part}" for path in robots for part in ("body", "outline")),
        *(f"/modes/robot_{robot}" for robot in range(ROBOTS)),
        "/arena/tracks",
        "/arena/pellets/loose",
        "/arena/pellets/held",
        "/arena/pheromone",
        "/arena/contacts",
        "/plots/delivered",
        "/plots/delivered_by_robot",
        "/plots/tunnel_density",
        "/plots/reward",
        "/log/collisions",
        "/log/deliveries",
    }
    assert set(recorded.rows) == changing
    still = {
        "/arena",
        "/arena/map",
        "/arena/walls",
        "/arena/zones",
        "/about",
        "/legend/swatches",
        "/legend/names",
        # Of clogs there are none here.
        "/arena/clogs",
        *(f"{path}/clog" for path in robots),
    }
    assert still <= set(recorded.static)
    assert recorded.static["/__properties/robosim"]["seed"] == ["5"]


def test_time_of_every_row_is_that_of_its_step(recorded):
    for path, rows in recorded.rows.items():
        if path != "/log/collisions":
            assert rows["sim_time"] == pytest.approx(rows["step"] * PERIOD, abs=1e-9)


def test_robots_are_shown_where_they_are(recorded, frames):
    pose = np.array([frame.pose for frame in frames])
    for robot in range(ROBOTS):
        path = f"/arena/robots/{robot}"
        place = np.array(recorded.shown(path, "Transform3D:translation"))[:, 0]
        x, y, z, w = np.array(recorded.shown(path, "Transform3D:quaternion"))[:, 0].T
        assert np.abs(place[:, :2] - pose[:, robot, :2]).max() <= POSITION_GRID * 1.01
        assert not place[:, 2].any()
        assert not x.any()
        assert not y.any()
        turn = 2.0 * np.arctan2(z, w) - pose[:, robot, 2]
        assert np.abs(np.arctan2(np.sin(turn), np.cos(turn))).max() <= HEADING_GRID * 1.01
        resting = np.flatnonzero((pose[1:, robot] == pose[:-1, robot]).all(axis=1)) + 1
        assert not np.isin(resting, recorded.rows[path]["step"]).any(), "a robot at rest costs no row"


def test_tracks_hold_where_all_robots_are_whenever_one_has_moved(recorded, frames, arena):
    grid = TRACK_GRID * arena.robot.width
    pose = np.array([frame.pose for frame in frames])[:, :, :2]
    tracks = np.array(recorded.shown("/arena/tracks", "Points2D:positions"))
    assert tracks.shape == pose.shape
    assert np.abs(tracks - pose).max() <= 0.501 * grid
    written = recorded.rows["/arena/tracks"]["step"]
    moved = np.append(True, (np.rint(pose[1:] / grid) != np.rint(pose[:-1] / grid)).any(axis=(1, 2)))
    assert written.tolist() == np.flatnonzero(moved).tolist()
    assert len(written) < STEPS
    colours = recorded.static["/arena/tracks"]["Points2D:colors"]
    assert colours == [_rgba(palette.ROBOTS[robot]) for robot in range(ROBOTS)]


def test_tracks_are_shown_for_the_last_twenty_seconds_on_both_timelines(file):
    reader = RrdReader(file)
    spans = {}
    for chunk in reader.stream(store=reader.blueprints()[0]):
        if chunk.entity_path.endswith("/ViewContents/overrides/arena/tracks/visualizers"):
            ranges = chunk.to_record_batch().column("VisibleTimeRanges:ranges").to_pylist()[0]
            spans = {one["timeline"]: one["range"] for one in ranges}
    assert {name: (span["start"], span["end"]) for name, span in spans.items()} == {
        "step": (-67, 0),
        "sim_time": (-20_000_000_000, 0),
    }


def test_modes_and_loads_are_written_when_they_change_and_only_then(recorded, frames):
    mode = np.array([frame.mode for frame in frames])
    laden = np.array([frame.laden for frame in frames])
    for robot in range(ROBOTS):
        changes = np.flatnonzero(np.append(True, mode[1:, robot] != mode[:-1, robot]))
        styles = [palette.MODES[Mode(code)] for code in mode[changes, robot]]
        lane = recorded.rows[f"/modes/robot_{robot}"]
        assert lane["step"].tolist() == changes.tolist()
        assert lane["StateChange:state"] == [[style.label] for style in styles]
        body = recorded.rows[f"/arena/robots/{robot}/body"]
        assert body["step"].tolist() == changes.tolist()
        assert body["LineStrips2D:colors"] == [[_rgba(style.colour)] for style in styles]
        configured = recorded.static[f"/modes/robot_{robot}"]
        assert configured["StateConfiguration:values"] == [palette.MODES[code].label for code in Mode]
        outline = recorded.shown(f"/arena/robots/{robot}/outline", "LineStrips2D:colors")
        colours = [palette.HELD_PELLET.colour if load else palette.OUTLINE for load in laden[:, robot]]
        assert outline == [[_rgba(colour)] for colour in colours]


@pytest.mark.parametrize(("name", "status"), [("loose", 0), ("held", 1)])
def test_pellets_are_shown_where_they_are(recorded, frames, name, status):
    shown = recorded.shown(f"/arena/pellets/{name}", "Points2D:positions")
    for frame, places in zip(frames, shown, strict=True):
        expected = frame.pellets[frame.pellet_status == status]
        assert len(places) == len(expected)
        if len(expected):
            assert np.abs(np.array(places) - expected).max() <= POSITION_GRID * 1.01
    assert len(recorded.rows[f"/arena/pellets/{name}"]["step"]) < STEPS


def test_contacts_are_shown_in_their_decision_and_then_taken_away(recorded, frames):
    rows = recorded.rows["/arena/contacts"]
    felt = [frame.contacts.where(frame.contacts.impulse > 0.0) for frame in frames]
    touching = [len(contacts.impulse) > 0 for contacts in felt]
    over = [now < before for now, before in zip(touching[1:], touching[:-1], strict=True)]
    assert rows["step"].tolist() == np.flatnonzero(np.array(touching) | [False, *over]).tolist()
    for index, step in enumerate(rows["step"]):
        contacts = felt[step]
        assert rows["impulse"][index] == pytest.approx(contacts.impulse, rel=1e-6)
        assert rows["Points2D:class_ids"][index] == contacts.kind.tolist()
        assert np.array(rows["Points2D:positions"][index]).reshape(-1, 2) == pytest.approx(contacts.position)
        order = np.argsort(contacts.impulse)
        assert (np.diff(np.array(rows["Points2D:radii"][index])[order]) >= 0.0).all(), "harder is larger"


def test_pheromone_is_shown_every_few_decisions_in_the_shade_of_its_occupancy(recorded, frames, arena):
    rows = recorded.rows["/arena/pheromone"]
    assert rows["step"].tolist() == list(range(0, STEPS, PHEROMONE_STEPS))
    for step, buffer, form in zip(
        rows["step"], rows["SegmentationImage:buffer"], rows["SegmentationImage:format"], strict=True
    ):
        assert (form[0]["width"], form[0]["height"]) == (arena.columns, arena.rows)
        shades = np.array(buffer[0]).reshape(arena.rows, arena.columns)
        occupancy = frames[step].pheromone.astype(np.float32)
        assert (shades == level_of_occupancy(occupancy)).all()
        assert occupancy_of_level(shades) == pytest.approx(occupancy, abs=0.06)


def test_plots_hold_what_the_frames_hold(recorded, frames):
    delivered = np.array([frame.delivered for frame in frames])
    team = recorded.shown("/plots/delivered", "Scalars:scalars")
    assert np.array(team)[:, 0].tolist() == delivered.sum(axis=1).tolist()
    each = recorded.shown("/plots/delivered_by_robot", "Scalars:scalars")
    assert np.array(each).tolist() == delivered.tolist()
    density = recorded.shown("/plots/tunnel_density", "Scalars:scalars")
    assert np.array(density)[:, 0].tolist() == [frame.density for frame in frames]
    for path in ("/plots/delivered", "/plots/tunnel_density", "/plots/reward"):
        assert recorded.rows[path]["step"][-1] == STEPS - 1, "lines reach the end of the run"
    reward = np.array([frame.reward.mean(dtype=np.float64) for frame in frames])
    for step, mean in zip(
        recorded.rows["/plots/reward"]["step"], recorded.rows["/plots/reward"]["Scalars:scalars"], strict=True
    ):
        assert mean[0] == pytest.approx(reward[step + 1 - REWARD_STEPS : step + 1].mean())


@pytest.mark.parametrize("name", ["delivered", "delivered_by_robot", "tunnel_density"])
def test_steps_of_a_plot_are_drawn_as_they_are(recorded, name):
    lines = recorded.static[f"/plots/{name}"]
    assert lines["SeriesLines:aggregation_policy"] == [AggregationPolicy.Off.value]
    assert lines["SeriesLines:interpolation_mode"] == [InterpolationMode.StepAfter.value]


def test_every_delivery_has_its_line(recorded, frames):
    delivered = np.array([frame.delivered for frame in frames])
    steps, robots = np.nonzero(np.diff(delivered, axis=0))
    rows = recorded.rows["/log/deliveries"]
    lines = [
        [f"{robot} brings home pellet {delivered[step + 1].sum()}"]
        for step, robot in zip(steps, robots, strict=True)
    ]
    assert rows["step"].tolist() == (steps + 1).tolist()
    assert rows["TextLog:text"] == lines


def test_hard_contacts_of_robots_have_lines_at_their_time_unless_one_was_just_written(
    recorded, frames, arena
):
    hard = HARD * arena.robot.mass * arena.robot.top_speed
    expected, last = [], {}
    for frame in frames:
        contacts = frame.contacts
        for kind, a, b, time, impulse in zip(
            contacts.kind, contacts.a, contacts.b, contacts.time, contacts.impulse, strict=True
        ):
            pair = tuple(sorted((int(a), int(b))))
            if kind == 0 and impulse >= hard:
                if time - last.get(pair, -np.inf) > LOG_PAUSE:
                    expected.append((round(float(time), 6), f"{a} and {b} hit each other, {impulse:.3f} N s"))
                last[pair] = time
    rows = recorded.rows["/log/collisions"]
    found = [
        (round(time, 6), text[0]) for time, text in zip(rows["sim_time"], rows["TextLog:text"], strict=True)
    ]
    assert sorted(found) == sorted(expected)
    assert len(expected) > 10


def test_contacts_of_a_world_without_forces_are_drawn_alike_and_written_without_an_impulse(tmp_path):
    env = VectorEnv("paper", robots=6, world="grid", episode_steps=200, autoreset=False)
    record_episode(make_controller("active"), env, tmp_path / "grid.rrd")
    rows = Reading(tmp_path / "grid.rrd").rows
    radii = [radius for drawn in rows["/arena/contacts"]["Points2D:radii"] for radius in drawn or []]
    lines = [text[0] for text in rows["/log/collisions"]["TextLog:text"]]
    assert len(radii) > 20
    assert len(set(radii)) == 1
    assert np.isfinite(radii[0])
    assert len(lines) > 5
    assert all(re.fullmatch(r"\d and \d hit each other", line) for line in lines)


def test_a_second_episode_is_refused_and_leaves_no_file(tmp_path, arena, frames):
    def record():
        with recording(tmp_path / "run.rrd", arena, robots=ROBOTS) as recorder:
            for frame in (frames[0], frames[1], frames[0]):
                recorder.add(frame)

    with pytest.raises(ValueError, match="step 0 does not follow step 1: a recording holds one episode"):
        record()
    assert list(tmp_path.iterdir()) == []


def test_a_run_of_no_frames_is_a_recording_of_the_arena(tmp_path, arena):
    path = tmp_path / "run.rrd"
    with recording(path, arena, robots=ROBOTS):
        pass
    recorded = Recorded(path)
    assert recorded.rows == {}
    assert "/arena/map" in recorded.static


@pytest.mark.parametrize(
    "parts",
    [
        [(3200, 3201), (3400, 3500)],
        [(0, 50), (70, 4120), (4130, STEPS)],
        [(0, 100), (200, ROWS + 100), (ROWS + 120, STEPS)],
    ],
    ids=["late", "over the end of a chunk", "up to the end of a chunk"],
)
def test_after_a_pause_rows_are_those_of_the_whole_and_lanes_have_a_gap(
    tmp_path, arena, frames, recorded, parts
):
    path = tmp_path / "run.rrd"
    with recording(path, arena, robots=ROBOTS) as recorder:
        for start, end in parts:
            recorder.pause()
            for frame in frames[start:end]:
                recorder.add(frame)
    found = Reading(path)
    kept = np.concatenate([np.arange(start, end) for start, end in parts])
    for robot in range(ROBOTS):
        lane, whole = found.rows[f"/modes/robot_{robot}"], recorded.rows[f"/modes/robot_{robot}"]
        empty = [
            step for step, state in zip(lane["step"], lane["StateChange:state"], strict=True) if not state
        ]
        assert empty == [end for _, end in parts[:-1]]
        name = "StateChange:state"
        assert found.shown(f"/modes/robot_{robot}", name, kept) == recorded.shown(
            f"/modes/robot_{robot}", name, kept
        )
        assert set(lane["step"]) <= set(whole["step"]) | set(empty) | {start for start, _ in parts}
        place = "Transform3D:translation"
        path_of_robot = f"/arena/robots/{robot}"
        apart = np.array(found.shown(path_of_robot, place, kept)) - recorded.shown(path_of_robot, place, kept)
        assert np.abs(apart).max() <= POSITION_GRID * 1.01
    for name in ("/plots/delivered", "/plots/delivered_by_robot", "/plots/tunnel_density"):
        assert found.shown(name, "Scalars:scalars", kept) == recorded.shown(name, "Scalars:scalars", kept)
    for start, end in parts:
        log, whole = found.rows["/log/deliveries"], recorded.rows["/log/deliveries"]
        assert _between(log, start, end) == _between(whole, start + 1, end), "the first row's is not logged"
    assert len(log["step"]) == sum(len(_between(log, *part)) for part in parts)


def _between(log, start, end):
    return [
        (int(step), text)
        for step, text in zip(log["step"], log["TextLog:text"], strict=True)
        if start <= step < end
    ]


def test_a_pause_with_nothing_before_or_after_it_changes_nothing(tmp_path, arena, frames):
    written = []
    for name, pauses in (("plain", False), ("paused", True)):
        path = tmp_path / f"{name}.rrd"
        with recording(path, arena, robots=ROBOTS) as recorder:
            if pauses:
                recorder.pause()
            for frame in frames[:30]:
                recorder.add(frame)
            if pauses:
                recorder.flush()
                recorder.pause()
        written.append({name: plain(rows) for name, rows in Reading(path).rows.items()})
    lanes = [f"/modes/robot_{robot}" for robot in range(ROBOTS)]
    for lane in lanes:
        assert written[1][lane]["step"].pop() == 30, "the lane ends"
        assert written[1][lane]["StateChange:state"].pop() == []
        written[1][lane]["sim_time"].pop()
    assert written[0] == written[1]


def _rgba(colour):
    red, green, blue = colour
    return (red << 24) | (green << 16) | (blue << 8) | 255
