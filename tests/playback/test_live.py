"""Recordings that may be watched while they are made."""

import signal

import pytest

from robosim.envs.vector import VectorEnv
from robosim.errors import IncompleteError
from robosim.playback import viewer
from robosim.playback.live import live_recording
from robosim.playback.recorder import recording
from robosim.playback.viewer import free_ports, live_viewer, served
from tests.playback.reading import Reading


def record(path, said, view):
    env = VectorEnv("paper", robots=2, seed=1, autoreset=False)
    env.reset()
    about = {"policy": "none"}
    with live_recording(path, env.arena, robots=2, about=about, view=view, say=said.append) as add:
        for _ in range(5):
            env.step([[0, 1]])
            add(env.frame())


@pytest.mark.parametrize("view", [False, True])
def test_without_a_display_only_the_file_is_written(tmp_path, monkeypatch, view):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    said = []
    record(tmp_path / "run.rrd", said, view)
    assert said == (
        [f"there is no display for the viewer: only {tmp_path / 'run.rrd'} is written"] if view else []
    )
    rows = Reading(tmp_path / "run.rrd").rows
    assert rows["/arena/robots/1"]["step"].tolist() == [1, 2, 3, 4, 5]


def test_a_viewer_that_is_closed_meanwhile_costs_nothing_of_the_recording(tmp_path):
    env = VectorEnv("paper", robots=2, seed=1, autoreset=False)
    env.reset()
    ports = free_ports(None)
    with served(ports) as process:
        url = f"rerun+http://127.0.0.1:{ports.data}/proxy"
        with recording(tmp_path / "run.rrd", env.arena, robots=2, viewer=url) as recorder:
            for step in range(30):
                if step == 10:
                    recorder.show()
                    process.kill()
                    process.wait()
                env.step([[0, 1]])
                recorder.add(env.frame())
    rows = Reading(tmp_path / "run.rrd").rows
    assert rows["/plots/tunnel_density"]["step"].max() == 30
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


def test_a_window_that_takes_no_recording_is_not_left_open(tmp_path, monkeypatch):
    program, start, started = tmp_path / "viewer", viewer.start, []
    program.write_text("#!/bin/sh\nexec sleep 60\n")
    program.chmod(0o755)

    def noted(*args, **options):
        started.append(start(*args, **options))
        return started[-1]

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "viewer_program", lambda: program)
    monkeypatch.setattr(viewer, "start", noted)
    monkeypatch.setattr(viewer, "_PATIENCE", 0.2)
    with (
        pytest.raises(IncompleteError, match="the viewer does not listen at port"),
        live_viewer(print, lingers=False),
    ):
        pass
    assert [process.returncode for process in started] == [-signal.SIGTERM]
