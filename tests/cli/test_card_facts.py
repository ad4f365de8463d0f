"""What a policy's card says in words."""

import pytest

from robosim.cli.card_facts import facts_of
from robosim.control.policy import find_policy, load_policy

AFTER = "after a while in place"


@pytest.mark.parametrize(
    ("drawing", "said"),
    [
        ({"temperature": None}, None),
        ({"temperature": 0.5}, "actions drawn at temperature 0.5"),
        (
            {"temperature": 0.5, "temperature_in_place": 2.0},
            f"actions drawn at temperature 0.5, {AFTER} at 2",
        ),
        (
            {"temperature": 0.5, "retreat_in_place": 8},
            f"actions drawn at temperature 0.5, {AFTER} retreating for 8 decisions, 2 with a pellet",
        ),
        (
            {
                "temperature": 0.5,
                "temperature_in_place": 20.0,
                "retreat_in_place": 8,
                "retreat_with_pellet": 9,
            },
            f"actions drawn at temperature 0.5, {AFTER} at 20 or retreating for 8 decisions, 9 with a pellet",
        ),
    ],
)
def test_how_actions_are_drawn_ends_the_line_on_the_network(drawing, said):
    card = load_policy("paper-4").card
    card = card.changed(network=card.network.changed(**drawing))
    (line,) = [
        text for _, text in facts_of("paper-4", card, find_policy("paper-4")) if "own observation" in text
    ]
    assert line.partition("blocked moves are not chosen")[2] == ("" if said is None else f", {said}")
