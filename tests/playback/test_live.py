"""Recordings that may be watched while they are made."""

import pytest

from robosim.envs.vector import VectorEnv
from robosim.playback import live
from robosim.playback.live import live_recording
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
    monkeypatch.setattr(live.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    said = []
    record(tmp_path / "run.rrd", said, view)
    assert said == (
        [f"there is no display for the viewer: only {tmp_path / 'run.rrd'} is written"] if view else []
    )
    rows = Reading(tmp_path / "run.rrd").rows
    assert rows["/arena/robots/1"]["step"].tolist() == [1, 2, 3, 4, 5]
