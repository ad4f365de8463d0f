"""Robots that have come to a stand retreat: against a slow reference, one robot at a time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.control.network import draws
from robosim.control.retreat import Known, Retreat, RetreatDecisions, known_for_retreats
from robosim.discretise.observation import NO_COLUMNS, Columns, MoveGains

HOME, SOURCE, IN_PLACE, LADEN, SIZE = 0, 4, 8, 9, 10


def observations(rng, shape, moves=4):
    """Gains of moves, some blocked, in a robot's own terms, and whether it stands and what it carries."""
    seen = np.zeros((*shape, SIZE), np.float32)
    gains = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], (2, *shape, moves))
    gains[:, rng.random((*shape, moves)) < 0.4] = -1.0
    seen[..., HOME : HOME + moves], seen[..., SOURCE : SOURCE + moves] = gains
    seen[..., IN_PLACE] = rng.choice([0.0, 0.45, 0.5, 0.95], shape)
    seen[..., LADEN] = rng.integers(0, 2, shape)
    return seen


def plainly(seen, action, drawn, left, decisions, moves):
    """What one robot does, and for how many decisions it retreats yet."""
    laden = seen[LADEN] == 1.0
    last_digits = int(drawn * 2**24) % 2**12
    if left == 0 and seen[IN_PLACE] >= 0.5 and last_digits < 0.1 * 2**12:
        left = decisions.with_pellet if laden else decisions.without_pellet
    if left == 0:
        return action, 0
    best, most = action, None
    for move in range(moves):
        home, source = seen[HOME + move], seen[SOURCE + move]
        # Without a pellet away from the source is home, and with one the reverse.
        away = source if laden else home
        if not (home <= -1.0 and source <= -1.0) and (most is None or away > most):
            best, most = move, away
    return best, left - 1


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    decisions=st.builds(RetreatDecisions, st.integers(3, 12), st.integers(1, 15)),
    moves=st.sampled_from([2, 4]),
    shape=st.sampled_from([(3,), (2, 5), (2, 2, 3)]),
)
def test_robots_retreat_as_one_by_one(seed, decisions, moves, shape):
    rng = np.random.default_rng(seed)
    retreat = Retreat(Known(MoveGains(HOME, SOURCE, moves), IN_PLACE, LADEN), decisions)
    left = np.zeros(shape, np.int64)
    expected_left = dict.fromkeys(np.ndindex(shape), 0)
    for decision in range(30):
        seen, actions = observations(rng, shape, moves), rng.integers(0, 5, shape)
        drawn = draws(seed + decision, shape)
        chosen = retreat(actions, seen, drawn, left)
        for robot in np.ndindex(shape):
            one = (seen[robot], actions[robot], drawn[robot], expected_left[robot])
            expected, expected_left[robot] = plainly(*one, decisions, moves)
            assert (chosen[robot], left[robot]) == (expected, expected_left[robot])


def test_one_of_ten_that_stand_begins_to_whatever_action_it_draws():
    """By the last digits of a draw, which say nothing of its first."""
    drawn = np.concatenate([draws(decision, (400, 5)).ravel() for decision in range(20)])
    seen = np.zeros((len(drawn), SIZE), np.float32)
    seen[:, IN_PLACE] = 0.5
    left = np.zeros(len(drawn), np.int64)
    retreat = Retreat(Known(MoveGains(HOME, SOURCE, 4), IN_PLACE, LADEN), RetreatDecisions(12, 4))
    retreat(np.zeros(len(drawn), np.int64), seen, drawn, left)
    begun = left == 11
    assert begun.mean() == pytest.approx(0.1, abs=0.005)
    assert np.corrcoef(begun, drawn)[0, 1] == pytest.approx(0.0, abs=0.02)


def test_a_retreat_goes_on_when_the_robot_has_come_away_and_then_ends():
    retreat = Retreat(Known(MoveGains(HOME, SOURCE, 4), IN_PLACE, LADEN), RetreatDecisions(6, 2))
    seen = np.zeros((2, SIZE), np.float32)
    seen[:, HOME + 2] = 1.0
    seen[:, SOURCE + 3] = 1.0
    seen[:, LADEN] = [0.0, 1.0]
    left = np.array([6, 2])
    nothing = np.full(2, 0.5, np.float32)
    taken = [retreat(np.array([3, 2]), seen, nothing, left).tolist() for _ in range(8)]
    assert taken == [[2, 3]] * 2 + [[2, 2]] * 4 + [[3, 2]] * 2


def test_what_robots_retreat_by_must_all_be_observed():
    whole = Columns(MoveGains(HOME, SOURCE, 4), IN_PLACE, LADEN)
    assert known_for_retreats(whole) == Known(*whole)
    for missing in ("gains", "in_place", "laden"):
        assert known_for_retreats(whole._replace(**{missing: None})) is None
    assert known_for_retreats(NO_COLUMNS) is None
