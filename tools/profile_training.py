"""Where the time of a training goes: acting, the environments, updates, the rest.

    python tools/profile_training.py [--robots 8] [--steps 20000] [--updates-per-step 0.25] [--arena paper]

Processor time of the one thread that does it all; exploration has run down before the clock starts.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from robosim.learning.computing import one_thread
from robosim.learning.config import run_config
from robosim.learning.training import Training


def main() -> None:
    with one_thread():
        _profile()


def _profile() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--arena", default="paper")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--updates-per-step", type=float, default=0.25)
    options = parser.parse_args()
    training = Training(run_config(**vars(options)))
    while training.step < options.steps // 5:
        training.advance()

    spent: defaultdict[str, float] = defaultdict(float)

    def timed(part: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            began = time.thread_time()
            result = work(*arguments)
            spent[part] += time.thread_time() - began
            return result

        return run

    algorithm: Any = training.algorithm
    learner = algorithm.learner
    env: Any = training.env
    algorithm.act = timed("choosing actions", algorithm.act)
    algorithm.update = timed("updates", algorithm.update)
    algorithm.observe = timed("storing experience", algorithm.observe)
    env.step = timed("environments", env.step)
    for space in env.world.spaces:
        space.advance = timed("of which bare Space.step", space.advance)
    before, decisions, updates = time.thread_time(), training.step, learner.updates
    # Only to the end of the episode: the next one has new spaces.
    while training.step < options.steps and env.steps_taken < env.episode_steps - 1:
        training.advance()
    total, decisions = time.thread_time() - before, training.step - decisions
    solver = spent.pop("of which bare Space.step")
    spent["the rest"] = total - sum(spent.values())
    print(
        f"{options.arena}, {options.robots} robots, {env.num_envs} environments, "
        f"{(learner.updates - updates) / decisions:.2f} updates a joint decision: "
        f"{1e6 * total / decisions:.0f} us a joint decision\n"
    )
    print("| part | us a joint decision | share |\n|---|---|---|")
    for part, seconds in sorted(spent.items(), key=lambda part: -part[1]):
        print(f"| {part} | {1e6 * seconds / decisions:.0f} | {seconds / total:.0%} |")
        if part == "environments":
            print(f"| - of which bare `Space.step` | {1e6 * solver / decisions:.0f} | {solver / total:.0%} |")


if __name__ == "__main__":
    main()
