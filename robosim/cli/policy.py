"""`robosim policy`: list the policies that ship, show the card of one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from robosim.cli.card_facts import facts_of, size, spread
from robosim.cli.tables import markdown, print_json, print_table

if TYPE_CHECKING:
    from robosim.control.card import PolicyCard


@dataclass(frozen=True)
class List:
    """List the policies that ship, with what they deliver."""

    markdown: bool = False
    """Print the table as Markdown."""
    json: bool = False
    """Print the list as JSON."""

    def run(self) -> None:
        from robosim.control.card import read_card
        from robosim.control.policy import CARD_FILE, find_policy, policy_names
        from robosim.errors import InputError

        if self.markdown and self.json:
            raise InputError("--markdown and --json are two ways to print one list: give one of them.")
        folders = {name: find_policy(name) for name in policy_names()}
        cards = {name: read_card(folder / CARD_FILE) for name, folder in folders.items()}
        if self.json:
            print_json([_record(name, card, folders[name]) for name, card in cards.items()])
            return
        rows = [_row(name, card, folders[name]) for name, card in cards.items()]
        if not rows:
            print("No policies ship with this robosim.")
        elif self.markdown:
            print("\n".join(markdown([_COLUMNS, *rows])))
        else:
            print_table(_COLUMNS, rows)


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
    """Policy by its folder."""
    clip: bool = True
    """By default the team is filmed, too; with this a clip that is there stays."""

    def run(self) -> None:
        from robosim.cli.model_card import write_readme
        from robosim.control.policy import README_FILE, RUN_POLICY, find_policy, policy_names, read_policy
        from robosim.errors import InputError

        folder = find_policy(self.policy)
        if self.policy in policy_names():
            raise InputError(f"{self.policy!r} ships with its page: {folder / README_FILE}.")
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


def _row(name: str, card: PolicyCard, folder: Path) -> tuple[str, ...]:
    evaluation = card.evaluation
    pellets = "not evaluated"
    if evaluation is not None:
        pellets = spread(evaluation)
        if evaluation.episode_steps != _LENGTH:
            pellets += f" in {evaluation.episode_steps}"
    return (
        name,
        card.arena.name,
        str(card.robots),
        card.technique.name,
        pellets,
        "" if card.share is None else f"{100 * card.share:.0f} %",
        size(folder),
    )


def _record(name: str, card: PolicyCard, folder: Path) -> dict[str, Any]:
    """Return what the list says of a policy, for other programs."""
    from robosim.control.policy import folder_size

    evaluation = card.evaluation
    return {
        "name": name,
        "arena": card.arena.name,
        "robots": card.robots,
        "technique": card.technique.name,
        "pellets": None if evaluation is None else evaluation.mean,
        "pellets_std": None if evaluation is None else evaluation.std,
        "decisions": None if evaluation is None else evaluation.episode_steps,
        "share_of_reference": card.share,
        "bytes": folder_size(folder),
    }
