"""Moving pictures of an episode: MP4 for players and slides, animated WebP or GIF for pages."""

from __future__ import annotations

import importlib
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path
from typing import IO, Any

from robosim.arena.model import Arena
from robosim.control.controller import Controller
from robosim.envs.render import LONG_SIDE, Painter, Pixels
from robosim.envs.vector import VectorEnv
from robosim.episodes.frame import Frame
from robosim.episodes.replay import begun, replay
from robosim.episodes.trajectory import Trajectory
from robosim.errors import InputError, refused
from robosim.files import require_writable, whole_file

SUFFIXES = (".mp4", ".webp", ".gif")
"""What the name of a film ends in."""
SPEEDS = (0.01, 1000.0)
"""Least and greatest speed, as a multiple of real time."""
LONG_SIDES = (64, 3840)
"""Pixels of the longer side of a picture, at least and at most."""
MOST_PICTURES = 1500
"""Of an animated WebP or GIF, which is held in memory whole, by those who make it and those who see it."""
_FASTEST = 30
"""Pictures a second at most; a faster film leaves decisions out."""
_WEBP_QUALITY = 60
_MP4_QUALITY = "20"
"""Of x264, where 18 cannot be told from the original, and 23 is its default."""


@dataclass(frozen=True)
class Pace:
    """Which decisions of an episode a film shows, and for how long."""

    every: int
    """A picture for each of so many decisions."""
    seconds: Fraction
    """How long a picture is seen."""

    @classmethod
    def of(cls, arena: Arena, speed: float = 1.0) -> Pace:
        """Return the pace of a film `speed` times as fast as what happened; InputError out of `SPEEDS`."""
        low, high = SPEEDS
        if not low <= speed <= high:
            raise refused("speed", speed, f"a number from {low:g} to {high:g}")
        period = Fraction(arena.timing.decision_period).limit_denominator(100_000)
        seconds = period / Fraction(speed).limit_denominator(1000)
        every = max(1, math.ceil(1 / (seconds * _FASTEST)))
        return cls(every, every * seconds)

    def pictures(self, decisions: int) -> int:
        """Return how many pictures there are of so many decisions and the start."""
        return 1 + decisions // self.every


def require_film(path: str | Path, pictures: int) -> None:
    """Raise InputError now, before long work, if a film of so many pictures cannot be written there later.

    ModuleNotFoundError if what writes such films is not installed.
    """
    suffix = Path(path).suffix
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: the name of a film must end in {', '.join(SUFFIXES[:-1])} or .gif.")
    if suffix == ".mp4":
        importlib.import_module("av")
    else:
        importlib.import_module("PIL")
        if pictures > MOST_PICTURES:
            raise InputError(
                f"{path}: would hold {pictures} pictures, but may hold {MOST_PICTURES}: take fewer "
                "decisions, a higher speed, or .mp4."
            )
    require_writable(path)


def driven(controller: Controller, env: VectorEnv) -> Iterator[Frame]:
    """Yield the frame at the start of a new episode of the first environment, and after each decision.

    A frame's arrays are valid until the next one. `env` must have been made with `autoreset=False`.
    """
    observation = env.reset()
    controller.reset(env)
    yield env.frame()
    while env.steps_taken < env.episode_steps:
        observation = env.step(controller.act(env, observation)).observation
        yield env.frame()


def film(
    frames: Iterable[Frame],
    arena: Arena,
    path: str | Path,
    *,
    speed: float = 1.0,
    long_side: int = LONG_SIDE,
) -> int:
    """Draw the frames of an episode, one a decision, into a film, and return how many pictures it has.

    The film is `speed` times as fast as what happened, and its pictures about `long_side` pixels long. Its
    format is what the name of the file ends in; it is written whole or not at all. Errors as of
    `require_film` and `Pace.of`.
    """
    pace, painter = Pace.of(arena, speed), Painter(arena, long_side)
    pictures = _Counted(painter.draw(frame) for frame in islice(frames, 0, None, pace.every))
    with whole_file(path) as part, part.open("wb") as file:
        write_pictures(file, pictures, pace.seconds, Path(path).suffix)
    return pictures.count


def film_trajectory(
    trajectory: Trajectory,
    path: str | Path,
    *,
    speed: float = 1.0,
    long_side: int = LONG_SIDE,
    source: str = "trajectory",
) -> int:
    """Run a trajectory again, and film it as `film` does.

    InputError, too, if it cannot be run; `source` is what the error calls it.
    """
    arena = begun(trajectory, source).arena
    return film(replay(trajectory, source), arena, path, speed=speed, long_side=long_side)


def film_bytes(
    frames: Iterable[Frame], arena: Arena, pace: Pace, *, long_side: int, quality: int = _WEBP_QUALITY
) -> bytes:
    """Return the animated WebP of some frames, for a page that holds all it needs; `film` says the rest."""
    painter = Painter(arena, long_side)
    pictures = (painter.draw(frame) for frame in islice(frames, 0, None, pace.every))
    file = io.BytesIO()
    write_pictures(file, pictures, pace.seconds, ".webp", quality)
    return file.getvalue()


def write_pictures(
    file: IO[bytes],
    pictures: Iterable[Pixels],
    seconds: Fraction,
    suffix: str,
    quality: int = _WEBP_QUALITY,
) -> None:
    """Write pictures [height, width, 3], each seen for `seconds`, in the format that `suffix` stands for.

    `quality` is that of WebP, from 0 to 100.
    """
    if suffix == ".mp4":
        _write_mp4(file, pictures, seconds)
    else:
        _write_animation(file, pictures, seconds, suffix, quality)


class _Counted:
    """Passes pictures on and counts them."""

    def __init__(self, pictures: Iterator[Pixels]) -> None:
        self._pictures = pictures
        self.count = 0

    def __iter__(self) -> Iterator[Pixels]:
        for picture in self._pictures:
            self.count += 1
            yield picture


def _write_mp4(file: IO[bytes], pictures: Iterable[Pixels], seconds: Fraction) -> None:
    import av

    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=1 / seconds, options={"crf": _MP4_QUALITY})
        # The one that every player knows; it halves the colours' resolution, so sizes must be even.
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = picture.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def _write_animation(
    file: IO[bytes], pictures: Iterable[Pixels], seconds: Fraction, suffix: str, quality: int
) -> None:
    from PIL import Image

    first, *others = map(Image.fromarray, pictures)
    # A GIF counts in hundredths of a second, WebP in thousandths: what is rounded must not add up.
    grid = 10 if suffix == ".gif" else 1
    ends = [grid * round(1000 * number * seconds / grid) for number in range(len(others) + 2)]
    lasting = [end - start for start, end in pairwise(ends)]
    kind: dict[str, Any] = {"format": "GIF"}
    if suffix == ".webp":
        kind = {"format": "WEBP", "quality": quality, "method": 4}
    first.save(file, save_all=True, append_images=others, duration=lasting, loop=0, **kind)
