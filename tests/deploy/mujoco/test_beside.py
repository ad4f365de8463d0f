"""A team in both engines, side by side in one recording."""

import re
import signal
import subprocess

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robosim.cli.main import main
from robosim.control.policy import load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.simulated import SimulatedRobots, driven
from robosim.playback.bodies import POSITION_GRID
from tests.playback.reading import Reading
from tests.processes import hearing_ctrl_c

pytest.importorskip("mujoco")
DECISIONS = 10


def fresh(seed=3):
    controller = Controller(load_policy("paper-2"))
    config = controller.config.changed(pellet_gradient=0.0, profile=None, episode_steps=0)
    return controller, SimulatedRobots(config, seed)


def test_frames_are_the_world_as_the_controller_drives_it():
    controller, robots = fresh()
    frames = [
        (frame.step, frame.pose.copy(), frame.action.copy(), frame.pheromone.copy(), frame.mode.copy())
        for frame in driven(controller, robots, DECISIONS)
    ]
    again, others = fresh()
    action = np.full(2, 4)
    for _, pose, taken, occupancy, mode in frames:
        assert_array_equal(others.world.state.pose[0], pose)
        assert_array_equal(taken, action)
        for _ in range(3):
            command = again.step(others.readings(), others.now)
            action = action if command.actions is None else command.actions
            others.obey(command)
        assert_array_equal(again.occupancy, occupancy)
        assert_array_equal(again.mode, mode)
    assert [frame[0] for frame in frames] == list(range(DECISIONS + 1))
    assert frames[-1][3].max() > 0.1


def test_both_engines_lie_in_one_recording_from_the_same_start(tmp_path, capsys):
    path = tmp_path / "both.rrd"
    command = ["deploy", "engines", "paper-2", "--decisions", str(DECISIONS), "--seed", "3"]
    assert main([*command, "--save", str(path)]) == 0
    assert (
        f"{path}: {DECISIONS} decisions, 0 pellets in pymunk, 0 pellets in mujoco" in capsys.readouterr().out
    )
    reading = Reading(path)
    shown = {
        engine: np.array(
            reading.shown(f"/{engine}/arena/robots/1", "Transform3D:translation", np.arange(DECISIONS + 1))
        )[:, 0, :2]
        for engine in ("pymunk", "mujoco")
    }
    true = [frame.pose[1, :2].copy() for frame in driven(*fresh(), DECISIONS)]
    assert_allclose(shown["pymunk"], true, atol=2 * POSITION_GRID)
    apart = np.abs(shown["pymunk"] - shown["mujoco"]).max(axis=1)
    assert apart[0] < 2 * POSITION_GRID
    assert 0.001 < apart.max() < 0.2
    # Each has a scene of its own, and rewards have none.
    for engine in ("pymunk", "mujoco"):
        assert {f"/{engine}/arena/map", f"/{engine}/about"} <= reading.static.keys()
    assert not [name for name in (*reading.rows, *reading.static) if "reward" in name]


def test_ctrl_c_keeps_what_has_been_recorded(tmp_path):
    path = tmp_path / "both.rrd"
    command = hearing_ctrl_c("deploy", "engines", "paper-2", "--decisions", "2000", "--save", str(path))
    process = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("step 200/2000  ")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "robosim: interrupted\n")
    played = re.search(r"both\.rrd: (\d+) decisions, \d+ pellets in pymunk, \d+ pellets in mujoco\n", out)
    assert played is not None
    last = int(played[1])
    assert 200 <= last < 2000
    reading = Reading(path)
    for engine in ("pymunk", "mujoco"):
        ends = [max(rows["step"]) for name, rows in reading.rows.items() if name.startswith(f"/{engine}/")]
        assert max(ends) == last


def test_wrong_usage_is_a_sentence(tmp_path, capsys):
    assert main(["deploy", "engines", "paper-2", "--decisions", "0"]) == 2
    assert capsys.readouterr().err.startswith(
        "robosim: --decisions is 0, but must be a whole number from 1 to"
    )
