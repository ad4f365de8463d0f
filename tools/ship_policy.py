"""Make a policy that ships out of a training run: rounded if need be, evaluated as shipped, with its card.

    python tools/ship_policy.py RUN_FOLDER NAME [--notes "..."] [--episodes 12] [--seed 7] [--half]

Writes policies/NAME/ whole or not at all: weights (equal networks once; float16 with --half, or where
float32 would exceed 1.5 MB) and the card, with the evaluation of the policy as it is stored and that of
`lanes` over the same episodes; then its README.md with a clip. A folder that would exceed 1.5 MB is refused.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robosim.arena import arena_names, load_arena
from robosim.cli.evaluate import summary
from robosim.cli.main import exit_code
from robosim.cli.model_card import write_readme
from robosim.control.card import Evaluation, PolicyCard
from robosim.control.controller import SCRIPTED, Controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.lanes import LanesController
from robosim.control.learned import LearnedController
from robosim.control.policy import find_policy, folder_size, read_policy, save_policy
from robosim.errors import InputError

MOST_BYTES = 1_500_000
"""What the folder of a policy that ships may hold."""
POLICIES = Path(__file__).resolve().parent.parent / "policies"

Weights = dict[str, NDArray[np.floating]]


def ship(
    run: str | Path,
    name: str,
    into: Path,
    *,
    notes: str = "",
    episodes: int = 12,
    seed: int = 7,
    half: bool = False,
    episode_steps: int | None = None,
    robots: int | None = None,
    command: str = "",
    clip: bool = False,
) -> PolicyCard:
    """Write the policy of a run to `into`/`name`, with its page, and return its card.

    InputError if it cannot ship. `clip` films the team for the page.
    Episodes are as long as the arena says, or else of `episode_steps` decisions. One network for all can ship
    as a team of another size, `robots`. `command` says how it learned where the card does not, as that of a
    sweep's run.
    """
    check_request(name, notes, episodes, seed)
    policy = read_policy(find_policy(run))
    card = policy.card
    if card.training.seed == seed:
        raise InputError(f"--seed is {seed}, the seed of the training: it must be another.")
    if card.arena.name not in arena_names() or load_arena(card.arena.name).text != card.env.arena:
        print(f"note: the arena {card.arena.name} of the card is not, or no longer, the one that ships")
    if robots is not None:
        card = resized(card, robots)
    training = card.training.changed(command=shown_command(card.training.command or command, name))
    card = card.changed(training=training, evaluation=None, reference=None, notes=notes)
    with tempfile.TemporaryDirectory() as scratch:
        draft = Path(scratch) / name
        weights, card = store(draft, policy.weights(), card, half)
        # Read back, so that what is evaluated is what users will load.
        shipped = LearnedController(read_policy(draft), name)
        evaluation = measure(shipped, card, episodes, seed, episode_steps)
        reference = measure(LanesController(), card, episodes, seed, episode_steps)
        card = card.changed(evaluation=evaluation, reference=reference)
        save_policy(draft, weights, card)
        if folder_size(draft) > MOST_BYTES:
            raise too_large(draft)
    save_policy(into / name, weights, card)
    write_readme(name, into / name, read_policy(into / name), clip)
    return card


def resized(card: PolicyCard, robots: int) -> PolicyCard:
    """Return the card of the same network with a team of `robots`; InputError unless all robots run one."""
    if not card.network.shared:
        raise InputError(f"--robots is {robots}: it needs a policy of which all robots run one network.")
    env, network = card.env.changed(robots=robots), card.network.changed(of_robot=(0,) * robots)
    return card.changed(env=env, network=network)


def store(draft: Path, weights: Weights, card: PolicyCard, half: bool) -> tuple[Weights, PolicyCard]:
    """Write `weights` [networks, ...] to the folder `draft`, in float32 if that fits and `half` is not asked.

    Returns weights and card as stored; InputError if they are too large even so.
    """
    distinct, copies = shared(weights)
    of_robot = tuple(copies[network] for network in card.network.of_robot)
    for precision in ("float16",) if half else ("float32", "float16"):
        with np.errstate(over="ignore"):  # what overflows is refused by save_policy, as not finite
            stored: Weights = {key: array.astype(precision) for key, array in distinct.items()}
        card = card.changed(network=card.network.changed(of_robot=of_robot, precision=precision))
        save_policy(draft, stored, card)
        if folder_size(draft) <= MOST_BYTES:
            return stored, card
    raise too_large(draft)


def check_request(name: str, notes: str, episodes: int, seed: int) -> None:
    """Raise InputError for what a policy cannot be shipped with."""
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name) or len(name) > 60:
        raise InputError(f"NAME is {name[:80]!r}: it must be of small letters and digits, joined by hyphens.")
    if name in SCRIPTED:
        raise InputError(f"NAME is {name!r}: it must not be that of a scripted controller.")
    if not 1 <= episodes <= 10_000:
        raise InputError(f"--episodes is {episodes}: it must be from 1 to 10000.")
    if seed < 0:
        raise InputError(f"--seed is {seed}: it must not be negative.")
    if len(notes) > 2000:
        raise InputError(f"--notes has {len(notes)} characters: it must have at most 2000.")


def shared(weights: Mapping[str, NDArray[np.float32]]) -> tuple[Weights, list[int]]:
    """Return `weights` [networks, ...] with equal networks stored once, and where each network is now."""
    networks = len(next(iter(weights.values())))
    contents = [
        b"".join(array[network].tobytes() for array in weights.values()) for network in range(networks)
    ]
    distinct = list(dict.fromkeys(contents))
    kept = [contents.index(content) for content in distinct]
    return {name: array[kept] for name, array in weights.items()}, list(map(distinct.index, contents))


def shown_command(command: str, name: str) -> str:
    """Return the training's command as anyone can run it: its run folder becomes runs/`name`.

    InputError for a command that is not known, or names other absolute paths.
    """
    try:
        words = iter(shlex.split(command))
    except ValueError as error:
        raise InputError(f"the card's training.command is not a whole command ({error}).") from None
    kept = []
    for word in words:
        if word == "--out":
            next(words, None)
        elif not word.startswith("--out="):
            kept.append(word)
    if not kept:
        raise InputError("the card's training.command is empty: a policy that ships must say how it learned.")
    if absolute := next((word for word in kept if re.match(r"(--[\w-]+=)?/", word)), None):
        raise InputError(
            f"the card's training.command holds {absolute!r}: no absolute path but that of --out may ship."
        )
    return shlex.join([*kept, "--out", f"runs/{name}"])


def measure(
    controller: Controller, card: PolicyCard, episodes: int, seed: int, episode_steps: int | None
) -> Evaluation:
    """Evaluate a controller where the policy learned, as `robosim evaluate` does."""
    env = environment_for(
        controller,
        card.env.arena,
        card.robots,
        card.env.world,
        num_envs=min(episodes, 16),
        seed=seed,
        episode_steps=episode_steps,
    )
    start = time.perf_counter()
    result = evaluate(controller, env, episodes, seed)
    print(f"{summary(result)}\n  took {time.perf_counter() - start:.0f} s", flush=True)
    return result


def too_large(folder: Path) -> InputError:
    """Return what is wrong with a policy folder that is too large to ship."""
    return InputError(
        f"policy {folder.name} would take {folder_size(folder)} bytes in float16: it must take at most "
        f"{MOST_BYTES}; train narrower hidden layers."
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("run", help="run folder, as `robosim train` leaves it")
    parser.add_argument("name", help="name of the policy, say paper-8")
    parser.add_argument("--notes", default="", help="what the policy fails at, in a sentence or two")
    parser.add_argument("--episodes", type=int, default=12, help="whole episodes to evaluate")
    parser.add_argument("--seed", type=int, default=7, help="seed of the evaluation, not the training's")
    parser.add_argument("--half", action="store_true", help="store float16 even where float32 would fit")
    parser.add_argument("--robots", type=int, help="team size on the card, where all robots run one network")
    parser.add_argument("--command", default="", help="how it learned, where a sweep's run does not say")
    parser.add_argument("--into", type=Path, default=POLICIES, help="folder of policies to write to")
    given = parser.parse_args(argv)

    def act() -> None:
        card = ship(
            given.run,
            given.name,
            given.into,
            notes=given.notes,
            command=given.command,
            episodes=given.episodes,
            seed=given.seed,
            half=given.half,
            robots=given.robots,
            clip=True,
        )
        folder = given.into / given.name
        share = "" if card.share is None else f", {100 * card.share:.1f} % of lanes"
        print(f"{folder}: {folder_size(folder)} bytes, {card.network.precision}{share}")

    return exit_code(act, debug=False)


if __name__ == "__main__":
    sys.exit(main())
