"""What a policy and an evaluation show of themselves in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robosim.html import facts_html

if TYPE_CHECKING:
    from robosim.control.card import Evaluation
    from robosim.control.policy import Policy

_MOST_EPISODES = 20
"""Episodes whose pellets are listed."""


def policy_html(policy: Policy) -> str:
    """Return how the policy learned, what drives it, and what its card claims."""
    card = policy.card
    network, training = card.network, card.training
    facts = [
        ("technique", card.technique.name),
        ("team", f"{card.robots} robots in arena {card.arena.name}, world {card.env.world}"),
        (
            "learned in",
            f"{training.steps:,} decisions, {training.wall_time / 60:.0f} minutes, seed {training.seed}",
        ),
        ("networks", f"{network.networks}, hidden layers {' x '.join(map(str, network.hidden)) or 'none'}"),
        ("observation", f"{len(card.observation)} numbers"),
        ("actions", f"{card.env.actions}, {network.actions}"),
        ("pellets", _pellets(card.evaluation) if card.evaluation else "not evaluated"),
        ("of the reference", "" if card.share is None else f"{100 * card.share:.0f} %"),
        ("fails at", card.notes),
    ]
    return facts_html("policy", facts)


def evaluation_html(evaluation: Evaluation) -> str:
    """Return pellets, collisions and distances, as means over episodes."""
    totals = evaluation.totals
    more = " ..." if len(totals) > _MOST_EPISODES else ""
    closest, lapses = evaluation.closest, evaluation.longest_lapse
    facts = [
        ("team", f"{evaluation.robots} robots in arena {evaluation.arena}, world {evaluation.world}"),
        ("pellets", _pellets(evaluation)),
        ("in each episode", " ".join(map(str, totals[:_MOST_EPISODES])) + more),
        ("by robot", " ".join(f"{mean:.1f}" for mean in evaluation.per_robot)),
        *((f"group {group.name}", group.words()) for group in evaluation.by_group),
        ("longest lapse", f"{max(lapses)} decisions without a delivery" if lapses else ""),
        ("collisions", f"{sum(evaluation.collisions) / evaluation.episodes:.1f} per episode"),
        ("least distance of two robots", f"{min(closest):.3f} m" if closest else ""),
        ("seed", evaluation.seed),
    ]
    return facts_html(f"evaluation of {evaluation.controller}", facts)


def _pellets(evaluation: Evaluation) -> str:
    """Return the pellets of an episode, mean and standard deviation, in words."""
    return (
        f"{evaluation.mean:.1f} ± {evaluation.std:.1f} in {evaluation.episode_steps} decisions, "
        f"{evaluation.episodes} episodes"
    )
