"""`robosim evaluate`: measure a trained policy or a scripted controller."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from robosim.control.card import Evaluation


@dataclass(frozen=True)
class Evaluate:
    """Run whole episodes without exploration, and count the pellets delivered."""

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, policy or run folder, or scripted controller by name."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the one a policy learned in, or `paper`."""
    robots: int | None = None
    """Team size; by default a policy's own, or 4."""
    episodes: int = 5
    """Episodes, run side by side."""
    steps: int | None = None
    """Decisions in an episode; by default as many as the arena says."""
    seed: int = 0
    """Root of all randomness."""
    json: Path | None = None
    """File to write the evaluation to."""

    def run(self) -> None:
        """Evaluate and print the figures."""
        from robosim.control.controller import make_controller
        from robosim.control.environment import environment_for
        from robosim.control.evaluate import evaluate
        from robosim.errors import InputError
        from robosim.files import require_writable, write_whole

        if not 1 <= self.episodes <= 10_000:
            raise InputError(f"--episodes is {self.episodes}: it must be from 1 to 10000.")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}: it must not be negative.")
        if self.json is not None:
            require_writable(self.json)
        controller = make_controller(self.policy)
        env = environment_for(
            controller,
            self.arena,
            self.robots,
            num_envs=min(self.episodes, 16),
            seed=self.seed,
            episode_steps=self.steps,
        )
        result = evaluate(controller, env, self.episodes, self.seed)
        print(summary(result))
        if self.json is not None:
            write_whole(self.json, result.model_dump_json(indent=2) + "\n")


def summary(evaluation: Evaluation) -> str:
    """Return the figures of an evaluation as a few lines."""
    robots = "  ".join(f"{mean:.1f}" for mean in evaluation.per_robot)
    return (
        f"{evaluation.controller} in {evaluation.arena}, {evaluation.robots} robots, "
        f"{evaluation.episodes} episodes of {evaluation.episode_steps} decisions:\n"
        f"  pellets per episode     {evaluation.mean:.1f} (standard deviation {evaluation.std:.1f})\n"
        f"  of each robot           {robots}\n"
        f"  collisions per episode  {sum(evaluation.collisions) / evaluation.episodes:.1f}"
    )
