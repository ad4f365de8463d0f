"""What a policy's card says, in words, line by line."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robosim.control.card import Evaluation, PolicyCard, StageCard
    from robosim.control.network import NetworkSpec

_NORMALISED = {
    "none": (),
    "rms": ("layers over their root mean square",),
    "layer": ("layers of mean 0 and variance 1",),
}


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
        ("", f"{card.robots} robots in arena {card.arena.name}, {size(folder)}"),
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
        *([("profile", env.profile.called)] if env.profile else []),
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
        *_drawn(network),
    )
    return [("network", f"{sizes}, {owners}, stored as {network.precision}"), ("", ", ".join(makes))]


def _drawn(network: NetworkSpec) -> list[str]:
    """Say how actions are drawn, if they are."""
    if network.temperature is None:
        return []
    standing, retreats = network.temperature_in_place, network.retreats
    in_place = [] if standing is None else [f"at {standing:g}"]
    if retreats is not None:
        in_place.append(
            f"retreating for {retreats.without_pellet} decisions, {retreats.with_pellet} with a pellet"
        )
    after = f", after a while in place {' or '.join(in_place)}" if in_place else ""
    return [f"actions drawn at temperature {network.temperature:g}{after}"]


def _results(what: str, evaluation: Evaluation) -> list[tuple[str, str]]:
    episodes = (
        f"{evaluation.episodes} episodes of {evaluation.episode_steps} decisions, seed {evaluation.seed}"
    )
    return [
        (what, f"{evaluation.controller} in {evaluation.arena}: {episodes}"),
        ("  pellets", f"{spread(evaluation)} per episode"),
        ("  episodes", "  ".join(map(str, evaluation.totals))),
        ("  robots", "  ".join(f"{mean:.1f}" for mean in evaluation.per_robot)),
        *((f"  {group.name}", group.words()) for group in evaluation.by_group),
        ("  collisions", f"{sum(evaluation.collisions) / evaluation.episodes:.1f} per episode"),
    ]


def spread(evaluation: Evaluation) -> str:
    """Return the pellets of an episode, mean and standard deviation."""
    deviation = f" +- {evaluation.std:.1f}" if evaluation.episodes > 1 else ""
    return f"{evaluation.mean:.1f}{deviation}"


def size(folder: Path) -> str:
    """Return what a policy's folder holds, in MB."""
    from robosim.control.policy import folder_size

    return f"{folder_size(folder) / 1e6:.2f} MB"
