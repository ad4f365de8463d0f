"""Films say what happened, as long as it took, in files that every player takes."""

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image

from robosim.analysis.film import (
    MOST_PICTURES,
    Pace,
    driven,
    film,
    film_trajectory,
    require_film,
    write_pictures,
)
from robosim.arena import load_arena
from robosim.arena.shipped import shipped_names
from robosim.control.controller import make_controller
from robosim.envs.render import Painter
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError


@pytest.mark.parametrize("name", shipped_names("arenas"))
@pytest.mark.parametrize("long_side", [64, 500, 960])
def test_pictures_of_every_arena_are_of_even_size(name: str, long_side: int) -> None:
    env = VectorEnv(name, robots=1)
    env.reset()
    height, width, _ = Painter(env.arena, long_side).draw(env.frame()).shape
    assert height % 2 == width % 2 == 0
    # A cell has 4 pixels at least.
    assert max(height, width) <= max(1.1 * long_side, 4 * max(env.arena.rows, env.arena.columns))


@pytest.mark.parametrize(
    ("speed", "every", "seconds"),
    [
        (1.0, 1, Fraction(3, 10)),
        (4.0, 1, Fraction(3, 40)),
        # 33 pictures a second would be too many: every second one is left out.
        (10.0, 2, Fraction(6, 100)),
        (0.1, 1, Fraction(3)),
    ],
)
def test_a_film_is_as_much_faster_as_asked_for(speed: float, every: int, seconds: Fraction) -> None:
    pace = Pace.of(load_arena("paper"), speed)
    assert (pace.every, pace.seconds) == (every, seconds)
    assert pace.seconds / pace.every * Fraction(speed) == pytest.approx(0.3)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_other_speeds_are_refused(speed: float) -> None:
    with pytest.raises(InputError, match=r"^speed is .*, but must be a number from 0\.01 to 1000\.$"):
        Pace.of(load_arena("paper"), speed)


def test_an_mp4_shows_the_pictures_of_the_decisions_in_time(tmp_path) -> None:
    def frames():
        env = VectorEnv("two-tunnels", robots=3, episode_steps=12, autoreset=False, seed=4)
        return env.arena, driven(make_controller("lanes"), env)

    arena, run = frames()
    assert film(run, arena, tmp_path / "run.mp4", speed=10.0, long_side=200) == 7
    painter, (_, again) = Painter(arena, 200), frames()
    pictures = [painter.draw(frame) for frame in again][::2]
    with av.open(tmp_path / "run.mp4") as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        shown = list(container.decode(stream))
    assert [float(one.time) for one in shown] == pytest.approx([0.06 * number for number in range(7)])
    for one, picture in zip(shown, pictures, strict=True):
        seen = one.to_ndarray(format="rgb24").astype(float)
        assert np.abs(seen - picture).mean() < 6.0


@pytest.mark.parametrize(("suffix", "grid"), [(".webp", 1), (".gif", 10)])
def test_an_animation_is_as_long_as_its_pictures_together(tmp_path, suffix: str, grid: int) -> None:
    # 75 ms each, which a GIF, in hundredths of a second, cannot say: what is rounded must not add up.
    pictures = np.random.default_rng(0).integers(0, 256, (40, 16, 16, 3), np.uint8)
    with (tmp_path / "film").open("wb") as file:
        write_pictures(file, pictures, Fraction(3, 40), suffix)
    lasting = []
    with Image.open(tmp_path / "film") as film_file:
        assert film_file.n_frames == 40
        for number in range(40):
            film_file.seek(number)
            film_file.load()
            lasting.append(film_file.info["duration"])
    assert np.abs(np.cumsum(lasting) - 75.0 * np.arange(1, 41)).max() <= 0.5 * grid


def test_an_animation_of_too_many_pictures_is_refused_before_work(tmp_path) -> None:
    pace, most = Pace.of(load_arena("paper")), MOST_PICTURES - 1
    require_film(tmp_path / "run.gif", pace.pictures(most))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="would hold 1501 pictures, but may hold 1500: take fewer decisions"):
        require_film(tmp_path / "run.gif", pace.pictures(most + 1))
    require_film(tmp_path / "run.mp4", pace.pictures(most + 1))


def test_a_trajectory_makes_the_film_of_the_episode_that_it_was(tmp_path) -> None:
    env = VectorEnv("paper", robots=2, episode_steps=10, autoreset=False, seed=4)
    assert film(driven(make_controller("lanes"), env), env.arena, tmp_path / "live.webp", long_side=100) == 11
    assert film_trajectory(env.trajectory(), tmp_path / "again.webp", long_side=100) == 11
    assert (tmp_path / "live.webp").read_bytes() == (tmp_path / "again.webp").read_bytes()


def test_a_film_that_fails_leaves_nothing_behind(tmp_path) -> None:
    def frames():
        env = VectorEnv("paper", robots=1, autoreset=False)
        env.reset()
        yield env.frame()
        raise KeyboardInterrupt

    for suffix in (".mp4", ".webp", ".gif"):
        with pytest.raises(KeyboardInterrupt):
            film(frames(), load_arena("paper"), tmp_path / f"run{suffix}", long_side=100)
    assert list(tmp_path.iterdir()) == []
