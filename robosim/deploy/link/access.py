"""Who meets where, and who may say what to whom: Zenoh's links, access control and TLS, as configuration.

Each process has a certificate whose common name is its own (`world`, `pheromones`, `robot-3`, `operator`),
and enforces these rules on every link, both ways: what is not allowed is not delivered. So only the process
of a robot can send its wheel commands, only the operator can hold and release the team, and no robot can say
anything to another.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pydantic import field_validator

from robosim.deploy.link.messages import MOST_BYTES
from robosim.errors import InputError, shown
from robosim.records import Record

AUTHORITY = "ca.pem"
WORLD, PHEROMONES, OPERATOR = "world", "pheromones", "operator"
_LEASE = 2000
"""ms without a sign of life after which Zenoh gives a link up; wheels do not wait for that."""
_QUEUE = 16
"""Batches that a link holds before it drops what is new."""
_WAIT = 3000
"""us that a message waits for room before it is dropped: longer, and one robot that is stuck holds up all."""
_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
_DECLARATIONS = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]


class LinkConfig(Record):
    """Where the processes of a team meet."""

    team: str = "team"
    """Name of the team: several may share a network."""
    world_at: str = "127.0.0.1:7447"
    """Address where the world, or the tracker, listens, HOST:PORT."""
    map_at: str = "127.0.0.1:7448"
    """Address where the pheromone service listens, HOST:PORT."""
    keys: str = ""
    """Folder with certificates and keys, for TLS and access control; empty for an open link."""

    @field_validator("team")
    @classmethod
    def _is_name(cls, team: str) -> str:
        if not re.fullmatch("[a-z0-9_-]{1,40}", team):
            raise ValueError(f"{shown(team)} is no name: it must be of 1 to 40 of a to z, 0 to 9, _ and -")
        return team

    @field_validator("world_at", "map_at")
    @classmethod
    def _is_address(cls, place: str) -> str:
        if not re.fullmatch(r"([A-Za-z0-9.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}", place):
            raise ValueError(f"{shown(place)} is no address: it must be HOST:PORT")
        return place

    @property
    def root(self) -> str:
        """The first parts of all keys."""
        return f"robosim/{self.team}"


def robot_name(robot: int) -> str:
    """Return the name that a robot's certificate carries."""
    return f"robot-{robot}"


def statements(robots: int) -> list[tuple[str, str, str]]:
    """Return who says what to whom, as (speaker, listener, key below the team's)."""
    allowed = [(WORLD, PHEROMONES, "clock"), (PHEROMONES, WORLD, "field")]
    allowed.append((PHEROMONES, WORLD, "alive/pheromones/*"))
    allowed += [(OPERATOR, WORLD, "order"), (WORLD, OPERATOR, "clock")]
    for robot in range(robots):
        name = robot_name(robot)
        allowed += [(WORLD, name, key) for key in ("clock", "pose/*", f"body/{robot}")]
        allowed += [(name, WORLD, key) for key in (f"wheels/{robot}", f"deposit/{robot}")]
        allowed += [(name, WORLD, f"alive/robot/{robot}/*"), (name, PHEROMONES, f"deposit/{robot}")]
        allowed += [(PHEROMONES, name, key) for key in (f"reading/{robot}", "alive/pheromones/*")]
    return allowed


def access_control(me: str, root: str, robots: int) -> dict[str, Any]:
    """Return Zenoh's `access_control` for the process `me` of a team below the key `root`."""
    rules: list[dict[str, Any]] = [
        {
            # That somebody listens tells nothing; what it may hear is said by the rules below.
            "id": "listening",
            "permission": "allow",
            "flows": ["ingress", "egress"],
            "messages": _DECLARATIONS,
            "key_exprs": [f"{root}/**"],
        }
    ]
    subjects, policies = [], []
    allowed = statements(robots)
    others = {speaker for speaker, _, _ in allowed} | {listener for _, listener, _ in allowed}
    for other in sorted(others - {me}):
        mine = ["listening"]
        for flow, speaker, listener in (("ingress", other, me), ("egress", me, other)):
            keys = [f"{root}/{key}" for one, two, key in allowed if (one, two) == (speaker, listener)]
            if keys:
                rule = f"{speaker} to {listener}"
                messages = ["put", "liveliness_token"]
                rules.append(
                    {
                        "id": rule,
                        "permission": "allow",
                        "flows": [flow],
                        "messages": messages,
                        "key_exprs": keys,
                    }
                )
                mine.append(rule)
        if len(mine) > 1:
            subjects.append({"id": other, "cert_common_names": [other]})
            policies.append({"rules": mine, "subjects": [other]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def tls(me: str, folder: Path) -> dict[str, Any]:
    """Return Zenoh's `transport/link/tls` for `me`, whose certificate and key lie in `folder`.

    InputError if one of the files is not there.
    """
    files = {
        "root_ca_certificate": folder / AUTHORITY,
        "listen_certificate": folder / f"{me}.pem",
        "listen_private_key": folder / f"{me}.key",
    }
    for path in files.values():
        if not path.is_file():
            raise InputError(
                f"{path}: not found; the folder of keys must hold {AUTHORITY}, {me}.pem, {me}.key."
            )
    whole = {name: str(path.resolve()) for name, path in files.items()}
    return {
        **whole,
        "connect_certificate": whole["listen_certificate"],
        "connect_private_key": whole["listen_private_key"],
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }


def settings_table(
    name: str, config: LinkConfig, listen: str, connect: tuple[str, ...], robots: int
) -> dict[str, Any]:
    """Return Zenoh's settings for a process, by their paths.

    Nobody is found by multicast or gossip, so links are those asked for: robots have none to each other.
    InputError if keys are missing.
    """
    protocol = "tls" if config.keys else "tcp"
    table: dict[str, Any] = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [f"{protocol}/{listen}"] if listen else [],
        "connect/endpoints": [f"{protocol}/{place}" for place in connect],
        # For ever, and in the background.
        "open/return_conditions/connect_scouted": False,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "transport/link/tx/lease": _LEASE,
        # The burst of a control period must find room: what does not is dropped.
        "transport/link/tx/queue/size/real_time": _QUEUE,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": _WAIT,
        "transport/link/rx/max_message_size": 4 * MOST_BYTES,
        "transport/shared_memory/enabled": False,
    }
    if config.keys:
        table["transport/link/tls"] = tls(name, Path(config.keys))
        table["access_control"] = access_control(name, config.root, robots)
    return table


def nested(table: dict[str, Any]) -> dict[str, Any]:
    """Return settings by their paths as the tables of a file that any Zenoh program reads."""
    whole: dict[str, Any] = {}
    for path, value in table.items():
        *parents, last = path.split("/")
        place = whole
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return whole
