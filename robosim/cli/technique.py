"""`robosim technique`: list what `robosim train --technique` takes, show one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from robosim.cli.tables import print_json, print_table


@dataclass(frozen=True)
class List:
    """List the techniques, and the algorithm of each."""

    json: bool = False
    """Print the list as JSON, with the options that each technique sets."""

    def run(self) -> None:
        from robosim.learning.technique import TECHNIQUES

        techniques = TECHNIQUES.values()
        if self.json:
            print_json(
                [
                    {
                        "name": one.name,
                        "algorithm": one.algorithm,
                        "description": one.about,
                        "options": dict(one.options),
                    }
                    for one in techniques
                ]
            )
        else:
            print_table(
                ("technique", "algorithm", "what it is"),
                [(one.name, one.algorithm, one.about) for one in techniques],
            )


@dataclass(frozen=True)
class Show:
    """Show what a technique sets; `robosim train --technique NAME --help` has all that can be set besides."""

    name: tyro.conf.Positional[str]
    """Technique by name."""

    def run(self) -> None:
        from robosim.errors import shown
        from robosim.learning.technique import MANY_ROBOTS, find_technique

        technique = find_technique(self.name)
        print(f"{technique.name}: {technique.about}")
        print(f"  {'algorithm':<22}  {technique.algorithm}")
        for options, when in (
            (technique.options, ""),
            (technique.with_wheels, "  (with wheel actions)"),
            (technique.with_many, f"  (from {MANY_ROBOTS} robots on)"),
        ):
            for name, value in options.items():
                print(f"  {name:<22}  {shown(value)}{when}")


@dataclass(frozen=True)
class Technique:
    """List the techniques, presets that `robosim train` starts from, or show what one sets."""

    do: Annotated[
        Annotated[List, tyro.conf.subcommand("list")] | Annotated[Show, tyro.conf.subcommand("show")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        self.do.run()
