"""Who moves when several want one cell: the rules, each on its own, and no robot favoured."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from robosim.world.grid.conflicts import Crowd
from tests.world.grid.plain import settled
from tests.world.grid.rooms import EAST, NORTH, SOUTH, STOP, WEST, Bench, room

COLUMNS, ROWS = 6, 5
STEPS = [(0, 1), (0, -1), (-1, 0), (1, 0), (0, 0)]
INNER = [(column, row) for row in range(1, ROWS - 1) for column in range(1, COLUMNS - 1)]


@st.composite
def crowds(draw, most=12):
    """Cells, wanted cells, an order of the robots and the free cells of a small floor."""
    walls = draw(st.sets(st.sampled_from(INNER), max_size=3))
    room = [cell for cell in INNER if cell not in walls]
    robots = draw(st.integers(1, min(most, len(room))))
    cells = draw(st.permutations(room))[:robots]
    steps = draw(st.lists(st.sampled_from(STEPS), min_size=robots, max_size=robots))
    targets = [(x + dx, y + dy) for (x, y), (dx, dy) in zip(cells, steps, strict=True)]
    return cells, targets, draw(st.permutations(range(robots))), set(room)


def flat(cells):
    return np.array([[row * COLUMNS + column for column, row in cells]])


def move(crowd):
    cells, targets, order, free = crowd
    mask = np.zeros(COLUMNS * ROWS, dtype=np.bool_)
    mask[flat(sorted(free))[0]] = True
    team = Crowd(mask, 1, len(cells))
    team.place(flat(cells))
    return team.move(flat(cells), flat(targets), np.array([order]))


@given(crowds())
def test_it_is_what_the_rules_say_one_robot_after_the_other(crowd) -> None:
    moved, walled, met = settled(*crowd)
    outcome = move(crowd)
    assert outcome.moved[0].tolist() == moved
    assert outcome.walled[0].tolist() == walled
    assert outcome.met[0].tolist() == met


@given(crowds(most=7))
def test_more_moves_than_that_the_rules_do_not_allow(crowd) -> None:
    """Of all sets of moves that are possible together, the one that holds every other."""
    cells, targets, order, free = crowd
    robots = range(len(cells))
    rank = {robot: place for place, robot in enumerate(order)}
    at = {cell: robot for robot, cell in enumerate(cells)}
    wants = {
        robot
        for robot in robots
        if targets[robot] != cells[robot]
        and targets[robot] in free
        and not (targets[robot] in at and targets[at[targets[robot]]] == cells[robot])
    }
    best = {
        max((r for r in wants if targets[r] == cell), key=rank.get) for cell in {targets[r] for r in wants}
    }
    largest: set[int] = set()
    for size in range(len(best) + 1):
        for movers in itertools.combinations(sorted(best), size):
            ends = [targets[robot] if robot in movers else cells[robot] for robot in robots]
            if len(set(ends)) == len(ends):
                largest |= set(movers)
    assert set(np.flatnonzero(move(crowd).moved[0]).tolist()) == largest


@given(crowds(), st.randoms(use_true_random=False))
def test_relabelled_robots_have_a_relabelled_outcome(crowd, random) -> None:
    cells, targets, order, free = crowd
    old_of = list(range(len(cells)))
    random.shuffle(old_of)
    new_of = {old: new for new, old in enumerate(old_of)}
    relabelled = move(
        (
            [cells[old] for old in old_of],
            [targets[old] for old in old_of],
            [new_of[old] for old in order],
            free,
        )
    )
    outcome = move(crowd)
    for one in ("moved", "walled", "met"):
        assert_array_equal(getattr(relabelled, one)[0], getattr(outcome, one)[0, old_of])


@given(st.lists(crowds(), min_size=2, max_size=4))
def test_environments_are_settled_side_by_side_as_they_are_alone(crowds_of_all) -> None:
    robots = min(len(crowd[0]) for crowd in crowds_of_all)
    free = set(INNER) - {(1, 1)}
    cut = []
    for cells, targets, order, _ in crowds_of_all:
        kept = [robot for robot in range(len(cells)) if cells[robot] in free][:robots]
        if len(kept) < robots:
            return
        ranks = [robot for robot in order if robot in kept]
        cut.append(([cells[r] for r in kept], [targets[r] for r in kept], [kept.index(r) for r in ranks]))
    mask = np.zeros(COLUMNS * ROWS, dtype=np.bool_)
    mask[flat(sorted(free))[0]] = True
    team = Crowd(mask, len(cut), robots)
    cells, targets = (np.concatenate([flat(one[part]) for one in cut]) for part in (0, 1))
    team.place(cells)
    together = team.move(cells, targets, np.array([one[2] for one in cut]))
    for env, one in enumerate(cut):
        assert_array_equal(together.moved[env], move((*one, free)).moved[0])


def test_a_robot_before_a_robot_that_stands_is_refused_and_both_are_in_the_contact() -> None:
    bench = Bench(room([(4, 3), (3, 3)]))
    assert bench.decide(STOP, EAST) == [(4, 3), (3, 3)]
    assert bench.state.touched[:, 0].tolist() == [[False, True], [False, False], [False, False]]
    contacts = bench.world.contacts
    assert (contacts.kind.tolist(), contacts.a.tolist(), contacts.b.tolist()) == ([0], [0], [1])
    assert contacts.position.tolist() == [pytest.approx([0.6, 0.525])]
    assert contacts.time.tolist() == pytest.approx([0.75])
    assert np.isnan(contacts.impulse).all()


def test_two_that_face_each_other_do_not_exchange_their_cells() -> None:
    bench = Bench(room([(3, 3), (4, 3)]))
    assert bench.decide(EAST, WEST) == [(3, 3), (4, 3)]
    assert bench.state.touched[0, 0].tolist() == [True, True]
    assert bench.world.contacts.a.tolist() == [0]
    assert bench.world.contacts.b.tolist() == [1]


def test_a_column_moves_as_one_and_stands_as_one() -> None:
    bench = Bench(room([(3, 3), (2, 3), (4, 3), (1, 3)]))
    assert bench.decide(EAST, EAST, EAST, EAST) == [(4, 3), (3, 3), (5, 3), (2, 3)]
    assert not bench.state.touched.any()
    assert bench.decide(EAST, EAST, STOP, EAST) == [(4, 3), (3, 3), (5, 3), (2, 3)]
    assert bench.state.touched[0, 0].tolist() == [True, True, False, True]


def test_a_column_of_all_that_fit_is_not_too_long() -> None:
    drawing = "\n" + "#" * 42 + "\n#H" + "." * 38 + "S#\n" + "#" * 42 + "\n"
    cells = [(column, 1) for column in range(1, 39)]
    bench = Bench(room(cells, drawing))
    assert bench.decide(*[EAST] * 38) == [(column + 1, 1) for column, _ in cells]
    assert bench.decide(*[EAST] * 38) == [(column + 2, 1) for column, _ in cells]
    bench.decide(*[EAST] * 38)
    assert bench.state.touched[1, 0].tolist() == [False] * 37 + [True]
    assert bench.state.touched[0, 0].tolist() == [True] * 37 + [False]


def test_four_in_a_circle_all_move_on() -> None:
    bench = Bench(room([(3, 3), (4, 3), (4, 2), (3, 2)]))
    assert bench.decide(EAST, SOUTH, WEST, NORTH) == [(4, 3), (4, 2), (3, 2), (3, 3)]
    assert not bench.state.touched.any()
    assert len(bench.world.contacts.env) == 0


def test_a_robot_may_enter_the_cell_that_another_leaves_sideways() -> None:
    bench = Bench(room([(3, 3), (4, 3)]))
    assert bench.decide(EAST, NORTH) == [(4, 3), (4, 4)]


def test_of_four_that_want_one_cell_each_gets_it_as_often() -> None:
    """In 8000 environments; a share of a quarter has a standard deviation of half a per cent."""
    bench = Bench(room([(3, 3), (5, 3), (4, 4), (4, 2)]), envs=8000)
    bench.decide(EAST, WEST, SOUTH, NORTH)
    middle = (np.array([4.5, 3.5]) * 0.15)[None, None]
    there = np.abs(bench.state.pose[..., :2] - middle).max(axis=2) < 1e-9
    assert (there.sum(axis=1) == 1).all()
    print("wins of each robot:", there.sum(axis=0))
    assert there.mean(axis=0) == pytest.approx([0.25] * 4, abs=0.02)
    # Who is refused has touched the one that got there, and not the reverse.
    assert_array_equal(bench.state.touched[0], ~there)
    winner = there.argmax(axis=1)
    contacts = bench.world.contacts
    assert len(contacts.env) == 3 * 8000
    assert ((contacts.a == winner[contacts.env]) | (contacts.b == winner[contacts.env])).all()


def test_who_goes_first_is_drawn_anew_in_every_decision() -> None:
    """Two that want one cell again and again: neither gets it always, and the order has no period of two."""
    bench = Bench(room([(3, 3), (5, 3)]), seed=3)
    wins = []
    for _ in range(400):
        cells = bench.decide(EAST, WEST)
        wins.append(cells.index((4, 3)))
        bench.decide(*([WEST, STOP] if wins[-1] == 0 else [STOP, EAST]))
    print("wins of the second robot:", sum(wins), "changes:", int(np.abs(np.diff(wins)).sum()))
    assert 150 < sum(wins) < 250
    assert 150 < np.abs(np.diff(wins)).sum() < 250
