from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.errors import InputError
from robosim.learning.config import run_config
from robosim.learning.curriculum import is_steady, plan_stages, stage_budget


def shapes(stages):
    return [(stage.name, stage.robots, stage.learning, stage.explores) for stage in stages]


def test_two_first_then_newcomers_one_at_a_time_then_all():
    config = run_config("smadrl", robots=4, fine_tune=0.5)
    assert shapes(plan_stages(config)) == [
        ("first team", 2, 2, True),
        ("newcomer 3", 3, 1, True),
        ("newcomer 4", 4, 1, True),
        ("fine-tuning", 4, 4, False),
    ]


def test_without_a_curriculum_all_learn_together():
    assert shapes(plan_stages(run_config("iql+gs", robots=4))) == [("together", 4, 4, True)]
    assert shapes(plan_stages(run_config(robots=4), trained=4)) == [("together", 4, 4, False)]


def test_a_trained_team_takes_the_place_of_the_first_stages():
    config = run_config("smadrl", robots=4, newcomer="copy")
    assert shapes(plan_stages(config, trained=3)) == [("newcomer 4", 4, 1, False)]
    config = run_config("smadrl", robots=1)
    assert shapes(plan_stages(config)) == [("first team", 1, 1, True)]


@pytest.mark.parametrize(
    ("options", "trained", "sentence"),
    [
        ({"robots": 2}, 3, "start_from holds 3 robots, but must hold at most the team's 2."),
        (
            {"robots": 3},
            2,
            "start_from holds 2 robots, but must hold the team's 3 without a curriculum.",
        ),
        (
            {"robots": 3, "technique": "smadrl"},
            3,
            "start_from holds 3 robots, but must hold less than the whole team without fine_tune.",
        ),
    ],
)
def test_a_policy_that_does_not_go_with_the_team_is_a_sentence(options, trained, sentence):
    with pytest.raises(InputError) as caught:
        plan_stages(run_config(**options), trained)
    assert str(caught.value) == sentence


@given(
    robots=st.integers(1, 16),
    first_team=st.integers(1, 4),
    fine_tune=st.sampled_from([0.0, 0.2, 0.5]),
    steps=st.integers(100, 10**6),
    early=st.lists(st.floats(0.6, 1.0), min_size=20, max_size=20),
)
def test_budgets_use_up_the_run_also_when_stages_end_early(robots, first_team, fine_tune, steps, early):
    config = run_config("smadrl", robots=robots, first_team=first_team, fine_tune=fine_tune)
    stages = plan_stages(config)
    taken = 0
    for number, stage in enumerate(stages):
        budget = stage_budget(stages, number, max(1, steps - taken))
        assert 1 <= budget <= max(1, steps - taken)
        last = stage is stages[-1]
        if last and fine_tune and taken == round((1 - fine_tune) * steps):
            assert budget == pytest.approx(fine_tune * steps, rel=0.02)
        taken += budget if last else max(1, round(early[number] * budget))
    assert steps <= taken <= steps + len(stages)


def budgets_of(config, steps=100_000):
    stages, left, budgets = plan_stages(config), steps, []
    for number in range(len(stages)):
        budgets.append(stage_budget(stages, number, left))
        left -= budgets[-1]
    assert left == 0
    return budgets


def test_shares_are_a_robots_worth_each():
    config = run_config("smadrl", robots=8, fine_tune=0.2)
    assert budgets_of(config) == [20_000, *[10_000] * 6, 20_000]


def test_the_first_team_takes_the_share_that_it_is_given():
    config = run_config("smadrl", robots=8, fine_tune=0.5, first_share=0.2)
    assert budgets_of(config) == [20_000, *[5_000] * 6, 50_000]
    assert budgets_of(config.with_options(fine_tune=0.0, first_share=0.4)) == [40_000, *[10_000] * 6]
    # Nobody joins the team: it learns, and learns on.
    assert budgets_of(config.with_options(robots=2)) == [50_000, 50_000]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"technique": "iql"}, "first_share is 0.5, but must be absent where no team learns first"),
        (
            {"technique": "smadrl", "start_from": "paper-4"},
            "first_share is 0.5, but must be absent where no team learns first",
        ),
        (
            {"technique": "smadrl", "fine_tune": 0.6},
            "first_share is 0.5, but must be less than 0.4, what fine_tune leaves",
        ),
    ],
)
def test_a_share_that_cannot_be_is_a_sentence(options, sentence):
    with pytest.raises(InputError, match=sentence):
        run_config(robots=4, first_share=0.5, **options)


def rows(rewards):
    return [SimpleNamespace(stage_step=100 * (i + 1), reward=reward) for i, reward in enumerate(rewards)]


def test_a_stage_is_steady_once_its_return_stops_growing():
    growing = [float(i) for i in range(10)]
    level = [5.0] * 10
    assert not is_steady(rows(growing), 1000, 0.01)
    assert is_steady(rows(level), 1000, 0.01)
    assert is_steady(rows([-9.0, -6.0, *[-5.0] * 4, *[-4.99] * 4]), 1000, 0.01)
    # Not before three fifths, not with nothing to compare, and never where the rule is off.
    assert not is_steady(rows(level[:5]), 1000, 0.01)
    assert is_steady(rows(level[:6]), 1000, 0.01)
    assert not is_steady([], 1000, 0.01)
    assert not is_steady(rows(level), 1000, 0.0)
