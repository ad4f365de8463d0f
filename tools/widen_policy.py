"""Widen the hidden layers of a policy's networks; what they compute stays the same.

    python tools/widen_policy.py POLICY --hidden 256 256 --out FOLDER

A training that starts from the wider policy goes on from what the narrow one could do, with room for more
(after Chen 2016, "Net2Net", arXiv:1511.05641). New units see what a unit of a fresh network sees, weighed at
random from --seed, and nothing sees them yet: weights from them begin at 0, where copies of old units would
have to be torn apart by noise.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robosim.cli.main import exit_code
from robosim.control.card import PolicyCard
from robosim.control.policy import load_policy, save_policy
from robosim.errors import InputError


def widen(policy: str | Path, hidden: Sequence[int], out: str | Path, seed: int = 0) -> PolicyCard:
    """Write the policy, a name or a folder, with hidden layers of those widths to `out`; return its card.

    InputError for fewer or other layers, a narrower one, and networks that normalise their hidden layers,
    which new units would change.
    """
    read = load_policy(policy)
    network = read.card.network
    if network.normalisation != "none":
        raise InputError(
            f"{policy}: its networks normalise hidden layers ({network.normalisation}), which new units "
            "change: only networks without normalisation can be widened."
        )
    if len(hidden) != len(network.hidden) or any(
        new < old for new, old in zip(hidden, network.hidden, strict=True)
    ):
        raise InputError(
            f"hidden is {' '.join(map(str, hidden))}: there must be {len(network.hidden)} widths, none "
            f"less than {' '.join(map(str, network.hidden))}."
        )
    rng = np.random.default_rng(seed)
    sizes = [network.inputs, *hidden]
    before = read.weights()
    wider: dict[str, NDArray[np.floating]] = {}
    for layer in range(len(sizes)):
        old, bias = before[f"layer{layer}.weight"], before[f"layer{layer}.bias"]
        outputs = hidden[layer] if layer < len(hidden) else old.shape[2]
        bound = sizes[layer] ** -0.5
        weight = rng.uniform(-bound, bound, (len(old), sizes[layer], outputs)).astype(old.dtype)
        weight[:, : old.shape[1], : old.shape[2]] = old
        weight[:, old.shape[1] :, : old.shape[2]] = 0
        wider[f"layer{layer}.weight"] = weight
        drawn = rng.uniform(-bound, bound, (len(old), outputs)).astype(bias.dtype)
        drawn[:, : bias.shape[1]] = bias
        wider[f"layer{layer}.bias"] = drawn
    command = ["python", "tools/widen_policy.py", str(policy), "--hidden", *map(str, hidden)]
    command += ["--seed", str(seed), "--out", str(out)]
    technique = read.card.technique
    card = read.card.changed(
        technique=technique.changed(facts={**technique.facts, "hidden": json.dumps(list(hidden))}),
        network=network.changed(hidden=tuple(hidden)),
        training=read.card.training.changed(command=shlex.join(command), stages=()),
        evaluation=None,
        reference=None,
        notes="",
    )
    save_policy(Path(out), wider, card)
    return load_policy(out).card


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("policy", metavar="POLICY", help="name, or policy or run folder")
    parser.add_argument("--hidden", type=int, nargs="+", required=True, help="widths of the hidden layers")
    parser.add_argument("--seed", type=int, default=0, help="of the new units' weights")
    parser.add_argument("--out", type=Path, required=True, help="folder to write the policy to")
    given = parser.parse_args(argv)

    def act() -> None:
        card = widen(given.policy, given.hidden, given.out, given.seed)
        print(f"{given.out}: hidden layers of {' and '.join(map(str, card.network.hidden))} units")

    return exit_code(act, debug=False)


if __name__ == "__main__":
    sys.exit(main())
