"""Film a team in both engines from the same start, one picture above the other, as an animated WebP.

python tools/film_engines.py paper-8 docs/images/engines.webp --from 200 --decisions 60
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from robosim.control.policy import Policy, load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.simulated import ENGINES, EngineKind, driven, make_stand_in
from robosim.envs.render import Painter
from robosim.episodes.frame import Frame
from robosim.files import whole_file

NAMES = {"pymunk": "pymunk: where the team has learned", "mujoco": "MuJoCo: three dimensions, driven wheels"}
STRIP = 26
"""Pixels above a picture for its name and the pellets delivered."""


def frames(policy: Policy, engine: EngineKind, options: argparse.Namespace) -> Iterator[Image.Image]:
    """Yield the pictures of the decisions that are asked for."""
    controller = Controller(policy)
    config = controller.config.changed(profile=None, pellet_gradient=0.0)
    robots = make_stand_in(engine, config, seed=options.seed, profile=options.profile)
    painter = Painter(robots.arena)
    for frame in driven(controller, robots, options.start + options.decisions):
        if frame.step > options.start:
            yield pictured(painter, frame, options.width, NAMES[engine])


def pictured(painter: Painter, frame: Frame, width: int, name: str) -> Image.Image:
    picture = Image.fromarray(painter.draw(frame))
    picture = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
    framed = Image.new("RGB", (width, picture.height + STRIP), "white")
    framed.paste(picture, (0, STRIP))
    text = f"{name}   {frame.time:.0f} s, {int(frame.delivered.sum())} pellets"
    ImageDraw.Draw(framed).text((6, 5), text, fill="black", font=ImageFont.load_default(14))
    return framed


def beside(pictures: tuple[Image.Image, ...]) -> Image.Image:
    """Return one picture above the other."""
    both = Image.new("RGB", (pictures[0].width, sum(one.height for one in pictures)), "white")
    top = 0
    for one in pictures:
        both.paste(one, (0, top))
        top += one.height
    return both


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("team", help="a policy that ships, or a policy or run folder")
    parser.add_argument("out", type=Path)
    parser.add_argument("--from", dest="start", type=int, default=0, help="decisions before the film begins")
    parser.add_argument("--decisions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--profile")
    parser.add_argument("--width", type=int, default=560, help="pixels")
    parser.add_argument("--quality", type=int, default=40)
    options = parser.parse_args()
    policy = load_policy(options.team)
    films = [frames(policy, engine, options) for engine in ENGINES]
    pictures = [beside(pair) for pair in zip(*films, strict=True)]
    # A decision lasts 0.3 s: shown twice as fast.
    with whole_file(options.out) as part:
        pictures[0].save(
            part,
            format="WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=round(500 * policy.card.arena.timing.decision_period),
            loop=0,
            quality=options.quality,
            method=6,
        )
    print(f"{options.out}: {len(pictures)} pictures, {options.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
