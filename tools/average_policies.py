"""Average the weights of teams that learned from one another, into one policy.

    python tools/average_policies.py POLICY POLICY ... --out FOLDER

Trainings that start from the same policy stay close enough for the mean of their weights to do as well as
they do, and often better than each in what the other had forgotten (Wortsman 2022, "Model soups",
arXiv:2203.05482). For trainings that began by themselves the mean is of no use. The card is that of the last
policy, with this command, and decisions and time of all; so that one says how actions are drawn, in which
teams may differ.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from robosim.cli.main import exit_code
from robosim.control.card import PolicyCard
from robosim.control.network import DRAWING, NetworkSpec, Weights
from robosim.control.policy import load_policy, save_policy
from robosim.errors import InputError


def _without_drawing(network: NetworkSpec) -> NetworkSpec:
    return network.changed(**dict.fromkeys(DRAWING))


def average(policies: Sequence[str | Path], out: str | Path) -> PolicyCard:
    """Write the mean of the policies, names or folders, to the folder `out`, and return its card.

    InputError unless there are two or more, with the same networks, observations and actions.
    """
    if len(policies) < 2:
        raise InputError("POLICY names one policy: an average needs two or more.")
    read = [load_policy(name) for name in policies]
    last = read[-1].card
    for name, policy in zip(policies, read, strict=True):
        for what, one, other in (
            ("network", _without_drawing(policy.card.network), _without_drawing(last.network)),
            ("observation", policy.card.observation, last.observation),
            ("env.actions", policy.card.env.actions, last.env.actions),
            ("technique", policy.card.technique.name, last.technique.name),
        ):
            if one != other:
                raise InputError(
                    f"{name}: its card's {what} is not that of {policies[-1]}: they must be equal."
                )
    weights = [policy.weights() for policy in read]
    mean: Weights = {
        key: np.stack([one[key] for one in weights]).mean(axis=0, dtype=np.float64).astype(array.dtype)
        for key, array in weights[-1].items()
    }
    trained = [policy.card.training for policy in read]
    command = ["python", "tools/average_policies.py", *map(str, policies), "--out", str(out)]
    training = last.training.changed(
        command=shlex.join(command),
        steps=sum(one.steps for one in trained),
        wall_time=sum(one.wall_time for one in trained),
        stages=(),
    )
    save_policy(Path(out), mean, last.changed(training=training, evaluation=None, reference=None, notes=""))
    return load_policy(out).card


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="name, or policy or run folder")
    parser.add_argument("--out", type=Path, required=True, help="folder to write the policy to")
    given = parser.parse_args(argv)

    def act() -> None:
        card = average(given.policies, given.out)
        print(
            f"{given.out}: the mean of {len(given.policies)} policies, {card.training.steps} decisions in all"
        )

    return exit_code(act, debug=False)


if __name__ == "__main__":
    sys.exit(main())
