"""Mixed teams as controllers, cards and evaluations see them."""

from __future__ import annotations

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.cli.evaluate import summary
from robosim.control.card import Evaluation, TrainingCard, card_for
from robosim.control.evaluate import evaluate
from robosim.control.lanes import LanesController
from robosim.control.learned import check_fit
from robosim.control.network import NetworkSpec
from robosim.control.protocols import ActiveController
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError

TRAINING = TrainingCard(command="none", seed=0, steps=0, wall_time=0.0, versions={})


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    env = VectorEnv("relay", robots=3, num_envs=2, episode_steps=200)
    return evaluate(LanesController(), env, 2, seed=4)


def test_an_evaluation_tells_what_each_group_did(evaluation: Evaluation) -> None:
    assert evaluation.groups == ("excavators", "transporters", "excavators")
    handed = np.array(evaluation.handed_over)
    excavators, transporters = evaluation.by_group
    assert (excavators.robots, transporters.robots) == (2, 1)
    assert excavators.handed_over == handed[:, [0, 2]].sum() / 2 > 0
    assert transporters.delivered == np.array(evaluation.delivered)[:, 1].sum() / 2
    assert (
        f"excavators              2 robots: 0.0 pellets brought home, {excavators.handed_over:.1f} handed"
        in (summary(evaluation))
    )
    again = Evaluation.model_validate_json(evaluation.model_dump_json())
    assert again == evaluation


def test_a_team_of_equals_has_no_groups() -> None:
    result = evaluate(LanesController(), VectorEnv("paper", robots=2, episode_steps=5), 1)
    assert (result.groups, result.handed_over, result.by_group) == (None, None, ())
    assert "robots:" not in summary(result)


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("groups", ("a",), "groups must hold 3 names, one for each robot."),
        ("handed_over", ((1, 2, 3),), "handed_over must hold 2 lists, one for each episode."),
        (
            "handed_over",
            ((1,), (2,)),
            "handed_over must hold 3 numbers, one for each robot, in each episode.",
        ),
    ],
)
def test_figures_of_groups_must_fit_the_team(
    evaluation: Evaluation, field: str, value: object, sentence: str
) -> None:
    with pytest.raises(InputError) as error:
        evaluation.changed(**{field: value})
    assert str(error.value) == sentence


def test_who_knows_of_no_roles_refuses_them_in_one_sentence() -> None:
    env = VectorEnv("relay", robots=2)
    env.reset()
    with pytest.raises(InputError) as error:
        ActiveController().reset(env)
    assert str(error.value) == (
        "active: knows of no roles, and the robots here dig or transport; `lanes` does."
    )


def test_a_card_shows_the_groups_and_fits_no_other_team() -> None:
    env = VectorEnv("relay", robots=4)
    spec = NetworkSpec(inputs=env.layout.size, hidden=(8,), of_robot=(0, 1, 0, 1))
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(size=shape).astype(np.float32) for name, shape in spec.shapes.items()}
    card = card_for(env, spec, weights, "by hand", TRAINING)
    groups = card.arena.groups
    assert groups is not None
    assert [(one.name, one.role, one.count) for one in groups] == [
        ("excavators", "excavator", 1),
        ("transporters", "transporter", 1),
    ]
    assert [one.robot.max_wheel_speed for one in groups] == [12.5, 25.0]
    check_fit(card, env, "own")
    text = load_arena("relay").text
    for other, sentence in (
        (
            text.replace("max_wheel_speed = 25.0", "max_wheel_speed = 20.0"),
            (
                "robot of transporters max_wheel_speed was 25.0 in training and is 20.0 here; to train a "
                "team for what is here, go on from it by --start-from"
            ),
        ),
        (
            text.replace('role = "transporter"', 'role = "transporter"\ncount = 2'),
            (
                "groups of robots was [('excavators', 'excavator', 1), ('transporters', 'transporter', 1)] "
                "in training and is [('excavators', 'excavator', 1), ('transporters', 'transporter', 2)] here"
            ),
        ),
    ):
        with pytest.raises(InputError) as error:
            check_fit(card, VectorEnv(load_arena(other), robots=4), "own")
        assert str(error.value) == f"policy own does not fit arena 'relay': {sentence}."
