"""The log of a controller as a recording: what it shows is what the log says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robosim.cli.main import main
from robosim.deploy.log import read_log
from robosim.deploy.retrace import Retrace
from robosim.discretise.modes import Mode
from robosim.episodes.columns import PHEROMONE_STEPS
from robosim.playback import palette
from robosim.playback.scene import level_of_occupancy
from tests.deploy.logs import logged_run
from tests.playback.reading import Reading


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    logged_run(folder / "run.jsonl", periods=90)
    assert main(["play", str(folder / "run.jsonl"), "--save", str(folder / "run.rrd")]) == 0
    frames = [
        (frame.mode.copy(), frame.pheromone.copy(), frame.pose.copy())
        for frame in Retrace(folder / "run.jsonl").frames()
    ]
    return list(read_log(folder / "run.jsonl")), frames, Reading(folder / "run.rrd")


def test_commands_are_those_of_the_log(played):
    logged, _, reading = played
    for side, path in enumerate(("/plots/wheels/left", "/plots/wheels/right")):
        rows = reading.rows[path]
        times = np.array([one.now for one in logged])
        latest = np.searchsorted(rows["sim_time"], times + 1e-6) - 1
        shown = np.array([rows["Scalars:scalars"][row] for row in latest])
        assert_array_equal(shown, [one.wheel_speeds[:, side] for one in logged])
    age = np.array(reading.rows["/plots/age"]["Scalars:scalars"])
    assert_array_equal(age, [one.now - one.readings.time for one in logged])


def test_robots_and_the_map_are_what_the_controller_held(played):
    _, frames, reading = played
    places = reading.rows["/arena/robots/0"]
    latest = np.searchsorted(places["sim_time"], 0.1 * np.arange(90) + 1e-6) - 1
    shown = np.array([places["Transform3D:translation"][row] for row in latest])[:, 0, :2]
    assert_allclose(shown, [pose[0, :2] for _, _, pose in frames], atol=2e-3)
    maps = reading.rows["/arena/pheromone"]
    pictures = [level_of_occupancy(field) for _, field, _ in frames[::PHEROMONE_STEPS]]
    times = 0.1 * PHEROMONE_STEPS * np.arange(len(pictures))
    for time, picture in zip(times, pictures, strict=True):
        row = np.searchsorted(maps["sim_time"], time + 1e-6) - 1
        assert_array_equal(np.ravel(maps["SegmentationImage:buffer"][row]), picture.ravel())
    assert max(picture.max() for picture in pictures) > 10
    lane = reading.rows["/modes/robot_1"]
    assert lane["StateChange:state"][0] == [palette.MODES[Mode(frames[0][0][1])].label]


def test_stops_are_lanes_and_events_with_their_reasons(played):
    _, _, reading = played
    lane = reading.rows["/stops/robot_1"]
    shown = zip(np.round(lane["sim_time"], 1), lane["StateChange:state"], strict=True)
    assert [(time, state or []) for time, state in shown] == [
        (2.0, ["no pose"]),
        (2.6, []),
        (4.0, ["a test"]),
        (5.0, []),
    ]
    events = reading.rows["/log/stops"]
    assert [text[0] for text in events["TextLog:text"]] == [
        "the controller begins",
        "1 is stopped: no pose",
        "1 goes on",
        "all are held: a test",
        "the emergency stop is over",
        "the controller begins",
    ]


def test_nothing_is_shown_that_a_log_does_not_know(played):
    _, _, reading = played
    paths = {*reading.rows, *reading.static}
    assert not [path for path in paths if "reward" in path or "delivered" in path or "contacts" in path]
    assert not [path for path in paths if "density" in path or "clogs" in path]
    about = reading.static["/about"]["TextDocument:text"][0]
    assert "- **observations**: those of the log in all 31 decisions, to the last bit" in about


def test_options_that_a_log_does_not_take_and_files_that_are_none(tmp_path, capsys):
    path, save = tmp_path / "run.jsonl", tmp_path / "run.rrd"
    logged_run(path, periods=6)
    assert main(["play", str(path), "--save", str(save), "--robots", "3"]) == 2
    assert capsys.readouterr().err == (
        f"robosim: --robots cannot be given with {path}: the log of a controller is shown as it is, whole or "
        "up to --steps.\n"
    )
    assert main(["play", str(path), "--save", str(save), "--steps", "1"]) == 0
    assert capsys.readouterr().out.startswith(f"{save}: 3 control periods, ")
    path.write_text("none\n")
    save.unlink()
    assert main(["play", str(path), "--save", str(save)]) == 2
    assert capsys.readouterr().err == f"robosim: {path}: line 1 is not a line of a controller's log.\n"
    assert not save.exists()
