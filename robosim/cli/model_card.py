"""The page beside a policy: what its card says, in Markdown, and the team in motion."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from robosim.cli.card_facts import facts_of
from robosim.control.policy import CLIP_FILE, README_FILE
from robosim.errors import InputError, without_controls

if TYPE_CHECKING:
    from robosim.control.card import PolicyCard
    from robosim.control.policy import Policy

MOST_CLIP_BYTES = 100_000
_BEFORE = 300
"""Decisions after which a clip begins: by then the robots are in the tunnel."""
_SHOWN = 40
"""Decisions in it."""
_SPEED = 4.0
_LONG_SIDE = 360
_QUALITY = 40


def readme_text(name: str, card: PolicyCard, facts: Sequence[tuple[str, str]], with_clip: bool) -> str:
    """Return the page of a policy: `facts` are what `robosim policy show` says of it, line by line."""
    robots = f"{card.robots} robot" + ("" if card.robots == 1 else "s")
    rows = [f"| {label.strip()} | {_cell(text)} |" for label, text in facts if text]
    lines = [
        "---",
        "library_name: robosim",
        "license: mit",
        "tags: [multi-agent, reinforcement-learning, robotics, swarm]",
        "---",
        "",
        f"# {name}",
        "",
        f"A team of {robots} that carries pellets in arena `{card.arena.name}`, trained with robosim.",
        "",
        *(
            [f"![The team at work, {_SPEED:g} times as fast as it happens]({CLIP_FILE})", ""]
            if with_clip
            else []
        ),
        "```python",
        "import robosim",
        "",
        f'team = robosim.make_controller("{name}")  # or the path of this folder',
        "env = robosim.vector_env(team.policy.card.env, num_envs=16)",
        "observation = env.reset()",
        "team.reset(env)",
        "step = env.step(team.act(env, observation))",
        "```",
        "",
        "| | |",
        "|---|---|",
        *rows,
        "",
        "Made by `robosim policy readme` from `card.json`, which holds all of it.",
    ]
    return "\n".join(lines) + "\n"


def clip_bytes(name: str, policy: Policy) -> bytes:
    """Return an animated WebP of the team in the middle of its work, in the episode that its card is about.

    InputError if it comes out larger than `MOST_CLIP_BYTES`.
    """
    from robosim.analysis.film import Pace, driven, film_bytes
    from robosim.control.environment import environment_for
    from robosim.control.learned import LearnedController

    controller = LearnedController(policy, name)
    seed = 0 if policy.card.evaluation is None else policy.card.evaluation.seed
    env = environment_for(controller, seed=seed, episode_steps=_BEFORE + _SHOWN, autoreset=False)
    pace = Pace.of(env.arena, _SPEED)
    frames = islice(driven(controller, env), _BEFORE, None)
    data = film_bytes(frames, env.arena, pace, long_side=_LONG_SIDE, quality=_QUALITY)
    if len(data) > MOST_CLIP_BYTES:
        raise InputError(
            f"the clip of {name} would take {len(data)} bytes, but must take at most {MOST_CLIP_BYTES}."
        )
    return data


def write_readme(name: str, folder: Path, policy: Policy, clip: bool) -> None:
    """Write the page into a policy's folder, and the clip that it shows; errors as of `clip_bytes`."""
    from robosim.files import write_whole

    if clip:
        write_whole(folder / CLIP_FILE, clip_bytes(name, policy))
    shown = (folder / CLIP_FILE).is_file()
    write_whole(
        folder / README_FILE, readme_text(name, policy.card, facts_of(name, policy.card, folder), shown)
    )


def _cell(text: str) -> str:
    """Return a text of a card for a Markdown table: it steers neither table nor terminal, and is no HTML."""
    plain = without_controls(text)
    for character in "\\|<>`*_[]":
        plain = plain.replace(character, f"\\{character}")
    return plain
