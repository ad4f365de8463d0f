"""What an environment shows of itself in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robosim.arena.picture import arena_svg, css
from robosim.envs.render import MODES
from robosim.html import facts_html

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv
    from robosim.envs.workers import WorkerVectorEnv

_MOST_ROBOTS = 100
"""Robots that are drawn."""


def environment_html(env: VectorEnv | WorkerVectorEnv, moment: str = "", marks: str = "") -> str:
    """Return the facts with a picture of the arena; `moment` and `marks` (SVG) say where it is now."""
    config = env.config
    facts = [
        ("environments", env.num_envs),
        ("robots", env.robots),
        ("world", config.world),
        ("observation", f"float32 [{env.num_envs}, {env.robots}, {env.layout.size}]"),
        ("actions", f"{config.actions}, 0 to {env.num_actions - 1}"),
        ("reward", config.reward.kind),
        ("episode", f"{env.episode_steps} decisions"),
        ("now", moment),
    ]
    return facts_html(f"{type(env).__name__} in {env.arena.name}", facts, arena_svg(env.arena, marks))


def moment_html(env: VectorEnv) -> str:
    """Return `environment_html` with the robots of the first environment, in the colours of their modes."""
    if env.episode < 0:
        return environment_html(env, "before the first reset")
    frame, cell = env.frame(), env.arena.cell_size
    sheets = env.arena.team(env.robots).sheets
    circles = [
        f'<circle cx="{x / cell:.2f}" cy="{env.arena.rows - y / cell:.2f}" '
        f'r="{sheet.outer_radius / cell:.2f}" fill="{css(MODES[int(mode)])}"/>'
        for sheet, (x, y, _), mode in zip(sheets, frame.pose[:_MOST_ROBOTS], frame.mode, strict=False)
    ]
    moment = (
        f"decision {env.steps_taken} of episode {env.episode}, {int(env.delivered[0].sum())} pellets home"
    )
    return environment_html(env, f"{moment} in the first environment", "".join(circles))
