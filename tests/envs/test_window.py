"""What environments show while they run."""

import os
import shutil
import subprocess
import sys
import time

import gymnasium
import pytest

import robosim
from robosim.envs.window import Window
from robosim.errors import InputError

tkinter = pytest.importorskip("tkinter")


@pytest.fixture(scope="module")
def display():
    """The name of a display of our own, without a screen."""
    if shutil.which("Xvfb") is None:
        pytest.skip("needs Xvfb")
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1200x800x24", "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as told:
            name = told.readline().strip()
        yield f":{name}"
        server.terminate()


@pytest.mark.parametrize("arena", ["paper", "two-tunnels"])
def test_every_face_says_how_many_pictures_a_second_are_real_time(arena: str) -> None:
    period = robosim.load_arena(arena).timing.decision_period
    for env in (
        gymnasium.make("robosim/Excavation-v0", arena=arena, render_mode="rgb_array").unwrapped,
        robosim.parallel_env(arena, robots=2),
    ):
        assert env.metadata["render_fps"] == pytest.approx(1 / period)
        assert env.metadata["render_modes"] == ["human", "rgb_array"]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_without_a_display_the_window_is_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    env = robosim.parallel_env("paper", robots=2, render_mode="human")
    with pytest.raises(InputError, match=r'^render_mode "human" needs a display for its window: '):
        env.reset(seed=0)


def test_a_window_shows_every_decision_at_the_pace_of_the_robots(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", display)
    env = gymnasium.make("robosim/Excavation-v0", robots=2, render_mode="human")
    began = time.monotonic()
    env.reset(seed=0)
    for _ in range(2):
        env.step(1)
    # Three pictures, each seen for 0.3 s before the next.
    assert time.monotonic() - began >= 0.6
    assert env.render() is None
    picture = robosim.envs.render.Painter(robosim.load_arena("paper")).draw(env.unwrapped._batch.frame())
    image = env.unwrapped._screen._window._image
    assert (image.width(), image.height()) == (picture.shape[1], picture.shape[0])
    for x, y in ((5, 5), (100, 150), (300, 144), (930, 200)):
        assert image.get(x, y) == tuple(picture[y, x].tolist())
    env.close()


def test_a_window_that_a_person_closes_shows_nothing_more(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", display)
    env = robosim.parallel_env("paper", robots=1, render_mode="human")
    env.reset(seed=0)
    window: Window = env._screen._window
    window.close()
    env.step({"robot_0": 1})
    env.close()
