"""`robosim profile`: list what `--profile` takes, show one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from robosim.cli.tables import print_json, print_table
from robosim.errors import printable, shown


@dataclass(frozen=True)
class List:
    """List the profiles that ship."""

    json: bool = False
    """Print the list as JSON."""

    def run(self) -> None:
        from robosim.envs.profile import load_profile, profile_names

        profiles = {name: load_profile(name) for name in profile_names()}
        about = {name: " ".join(one.description.split()) for name, one in profiles.items()}
        if self.json:
            print_json([{"name": name, "description": words} for name, words in about.items()])
        else:
            print_table(("profile", "what it stands for"), list(about.items()))


@dataclass(frozen=True)
class Show:
    """Show what a profile says of robots and what they perceive, as far as it differs from nothing."""

    profile: tyro.conf.Positional[str]
    """Profile by name, or its file."""

    def run(self) -> None:
        from robosim.envs.profile import load_profile

        profile = load_profile(self.profile)
        print(printable(f"{profile.name or self.profile}: {profile.description}".strip(), 3000))
        for table, fields in profile.model_dump(
            exclude_defaults=True, exclude={"name", "description"}
        ).items():
            for name, value in fields.items():
                print(f"  {f'{table}.{name}':<28}  {shown(value)}")


@dataclass(frozen=True)
class Profile:
    """List the profiles, what is random and wrong about robots and what they perceive, or show one."""

    do: Annotated[
        Annotated[List, tyro.conf.subcommand("list")] | Annotated[Show, tyro.conf.subcommand("show")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        self.do.run()
