"""`robosim policy`: list the policies that ship, show the card of one."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from robosim.cli.tables import markdown

if TYPE_CHECKING:
    from robosim.control.card import Evaluation, PolicyCard, StageCard
    from robosim.control.network import NetworkSpec


@dataclass(frozen=True)
class List:
    """List the policies that ship, with what they deliver."""

    markdown: bool = False
    """Print the table as Markdown."""

    def run(self) -> None:
        from robosim.control.card import read_card
        from robosim.control.policy import CARD_FILE, find_policy, policy_names

        rows = []
        for name in policy_names():
            folder = find_policy(name)
            rows.append(_row(name, read_card(folder / CARD_FILE), folder))
        if not rows:
            print("No policies ship with this robosim.")
        elif self.markdown:
            print("\n".join(markdown([_COLUMNS, *rows])))
        else:
            _print_table(rows)


@dataclass(frozen=True)
class Show:
    """Show a policy's card: how it learned, what it delivers, and where it fails."""

    policy: tyro.conf.Positional[str]
    """Trained policy by name, or policy or run folder."""
    json: bool = False
    """Print the card itself, as JSON."""

    def run(self) -> None:
        from robosim.control.card import card_text
        from robosim.control.controller import SCRIPTED
        from robosim.control.policy import find_policy, read_policy
        from robosim.errors import InputError, without_controls

        if self.policy in SCRIPTED:
            raise InputError(f"{self.policy!r} is a scripted controller: it has no card.")
        folder = find_policy(self.policy)
        card = read_policy(folder).card
        if self.json:
            print(card_text(card), end="")
            return
        for what, text in facts_of(self.policy, card, folder):
            # A card may come from a stranger.
            print(f"{what:<14}{without_controls(text)}".rstrip())


@dataclass(frozen=True)
class Readme:
    """Write README.md into a policy's folder, made of its card, with a short clip of the team beside it."""

    policy: tyro.conf.Positional[str]
    """Policy by its folder, or the name of one that ships."""
    clip: bool = True
    """Film the team, too; otherwise a clip that is there stays."""

    def run(self) -> None:
        from robosim.cli.model_card import write_readme
        from robosim.control.policy import README_FILE, RUN_POLICY, find_policy, read_policy
        from robosim.errors import InputError

        folder = find_policy(self.policy)
        if folder.name == RUN_POLICY:
            raise InputError(f"{folder}: a run keeps this folder as it wrote it: copy it, and give the copy.")
        write_readme(folder.resolve().name, folder, read_policy(folder), self.clip)
        print(f"written: {folder / README_FILE}")


@dataclass(frozen=True)
class Policy:
    """List the policies that ship, show the card of one, write the page of one."""

    do: Annotated[
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Readme, tyro.conf.subcommand("readme")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        self.do.run()


_LENGTH = 5000
"""Decisions in the episodes that the table is about."""
_COLUMNS = ("name", "arena", "robots", "technique", f"pellets in {_LENGTH} decisions", "of lanes", "size")
_WIDTH_PIPED = 220
"""Wider than the table, so that nothing that is piped is wrapped."""
_NORMALISED = {
    "none": (),
    "rms": ("layers over their root mean square",),
    "layer": ("layers of mean 0 and variance 1",),
}


def _row(name: str, card: PolicyCard, folder: Path) -> tuple[str, ...]:
    evaluation = card.evaluation
    pellets = "not evaluated"
    if evaluation is not None:
        pellets = _spread(evaluation)
        if evaluation.episode_steps != _LENGTH:
            pellets += f" in {evaluation.episode_steps}"
    return (
        name,
        card.arena.name,
        str(card.robots),
        card.technique.name,
        pellets,
        "" if card.share is None else f"{100 * card.share:.0f} %",
        _size(folder),
    )


def _print_table(rows: list[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(*_COLUMNS, box=None, header_style="bold")
    for row in rows:
        table.add_row(*row)
    width = None if sys.stdout.isatty() else _WIDTH_PIPED
    Console(highlight=False, markup=False, emoji=False, width=width).print(table)


def facts_of(name: str, card: PolicyCard, folder: Path) -> list[tuple[str, str]]:
    """Say in words what the card holds: (what, text) of each line."""
    quoted = shlex.quote(name)
    recording = shlex.quote(f"{Path(name).resolve().name}.rrd")
    evaluation = card.evaluation
    measure = f"robosim evaluate {quoted}"
    if evaluation is not None:
        measure += f" --episodes {evaluation.episodes} --seed {evaluation.seed}"
        if evaluation.episode_steps != card.arena.timing.episode_steps:
            measure += f" --steps {evaluation.episode_steps}"
    return [
        ("policy", name),
        ("", f"{card.robots} robots in arena {card.arena.name}, {_size(folder)}"),
        ("", ""),
        *_learning(card),
        ("", ""),
        *_layout(card),
        ("", ""),
        *(_results("evaluation", evaluation) if evaluation else [("evaluation", "none")]),
        *(_results("reference", card.reference) if card.reference else []),
        *([("share", f"{100 * card.share:.1f} % of the reference")] if card.share is not None else []),
        ("fails at", card.notes or "not noted"),
        ("", ""),
        ("see it", f"robosim play {quoted} --save {recording}"),
        ("measure it", measure),
    ]


def _learning(card: PolicyCard) -> list[tuple[str, str]]:
    training, reward = card.training, card.env.reward
    facts = ", ".join(f"{what} {fact}" for what, fact in card.technique.facts.items())
    pays = (
        f"pickups and deliveries pay {'the whole team' if reward.kind == 'global' else 'the robot itself'}",
        *(["distance lost costs"] if reward.signed_distance else []),
        *(["standing costs"] if reward.idle_cost else []),
    )
    return [
        ("technique", card.technique.name + (f": {facts}" if facts else "")),
        ("reward", ", ".join(pays)),
        ("command", training.command or "not noted"),
        ("seed", str(training.seed)),
        ("learned for", f"{training.steps} joint decisions, {training.wall_time:.0f} s"),
        *(("" if number else "stages", _stage(stage)) for number, stage in enumerate(training.stages)),
        ("versions", ", ".join(f"{package} {version}" for package, version in training.versions.items())),
    ]


def _stage(stage: StageCard) -> str:
    ending = "until steady" if stage.ended == "steady" else "the whole budget"
    return (
        f"{stage.name}: {stage.learning} of {stage.robots} robots learned for {stage.steps} joint decisions, "
        f"{ending}"
    )


def _layout(card: PolicyCard) -> list[tuple[str, str]]:
    arena, env, period = card.arena, card.env, card.arena.timing.decision_period
    pheromones = "with" if env.stigmergy else "without"
    return [
        ("arena", f"{arena.name}, cells of {arena.cell_size:g} m, text {arena.sha256[:12]}"),
        ("world", env.world),
        *([("profile", env.profile.name or "without a name")] if env.profile else []),
        ("observation", f"{len(card.observation)} numbers, {env.encoding}, {pheromones} pheromones"),
        ("actions", f"{card.network.actions}, {env.actions}, every {period:g} s"),
        *_network(card.network),
    ]


def _network(network: NetworkSpec) -> list[tuple[str, str]]:
    """Say what the networks are: their layers, and what they make of them."""
    sizes = " x ".join(map(str, (network.inputs, *(outputs for _, outputs in network.layers))))
    if network.joint:
        owners = "one for the whole team"
    elif network.shared:
        owners = "one that all robots run"
    elif network.networks == network.robots:
        owners = "one for each robot"
    else:
        owners = f"{network.networks} for {network.robots} robots"
    seen = "the robot's own observation" if network.input == "own" else "the observations of the team"
    makes = (
        f"{network.output} from {seen}",
        network.activation,
        *_NORMALISED[network.normalisation],
        *(["blocked moves are not chosen"] if network.mask else []),
        *([] if network.temperature is None else [f"actions drawn at temperature {network.temperature:g}"]),
    )
    return [("network", f"{sizes}, {owners}, stored as {network.precision}"), ("", ", ".join(makes))]


def _results(what: str, evaluation: Evaluation) -> list[tuple[str, str]]:
    episodes = (
        f"{evaluation.episodes} episodes of {evaluation.episode_steps} decisions, seed {evaluation.seed}"
    )
    return [
        (what, f"{evaluation.controller} in {evaluation.arena}: {episodes}"),
        ("  pellets", f"{_spread(evaluation)} per episode"),
        ("  episodes", "  ".join(map(str, evaluation.totals))),
        ("  robots", "  ".join(f"{mean:.1f}" for mean in evaluation.per_robot)),
        *((f"  {group.name}", group.words()) for group in evaluation.by_group),
        ("  collisions", f"{sum(evaluation.collisions) / evaluation.episodes:.1f} per episode"),
    ]


def _spread(evaluation: Evaluation) -> str:
    return f"{evaluation.mean:.1f} +- {evaluation.std:.1f}"


def _size(folder: Path) -> str:
    from robosim.control.policy import folder_size

    return f"{folder_size(folder) / 1e6:.2f} MB"
