"""The leaderboard: who is ranked, by what, and who stands beside."""

import numpy as np
import pytest

from robosim.control.card import fingerprint, read_card
from robosim.control.policy import CARD_FILE, find_policy
from robosim.errors import InputError
from robosim.experiments.leaderboard import committed_records, leaderboard
from robosim.experiments.runs import Task, read_runs
from robosim.experiments.statistics import estimate, interquartile_mean, mean
from tests.experiments.made import evaluation, folder, rekey, result

TASK = Task("paper", "grid", 300, 2)


@pytest.fixture
def records(tmp_path):
    """A sweep's results: two techniques, one of them in two ways, and lanes; a single seed of another."""
    path = tmp_path / "ours.results.jsonl"
    for seed, pellets in enumerate((20, 22, 21, 19)):
        result(path, "lanes", seed, [pellets, pellets], learned=False)
    for seed, pellets in enumerate((30, 20, 25)):
        result(path, "ps-dqn", seed, [pellets, pellets + 2], steps=400)
        result(path, "ps-dqn", seed, [pellets - 9, pellets - 9], steps=400, learning_rate=0.1, discount=0.5)
        result(path, "iql", seed, [pellets + 30, 0], steps=800)
    result(path, "vdn", 0, [99, 99])
    return path


def rows(board, task=TASK):
    return {entry.system: entry for entry in dict(board.by_task())[task]}


def test_methods_are_ranked_by_the_interquartile_mean_over_their_seeds(records):
    board = leaderboard([records], {})
    found = rows(board)
    assert list(found) == ["iql", "ps-dqn learning_rate=0.001", "lanes", "ps-dqn learning_rate=0.1"]
    assert [entry.rank for entry in found.values()] == [1, 2, 3, 4]
    best = found["ps-dqn learning_rate=0.001"]
    assert best.pellets == estimate(interquartile_mean, np.array([31.0, 21.0, 26.0]))
    assert (best.kind, best.seeds, best.episodes, best.steps, best.source) == (
        "trained",
        3,
        6,
        400,
        "robosim",
    )
    assert best.share == best.pellets.value / found["lanes"].pellets.value
    assert (found["lanes"].kind, found["lanes"].steps, found["lanes"].share) == ("scripted", None, 1.0)
    assert found["iql"].steps == 800
    assert board.notes == ["1 runs are left out: of their systems there are fewer than 3 seeds."]


def test_those_of_others_are_ranked_among_ours_and_one_team_stands_beside(records, tmp_path):
    theirs, runs, team = tmp_path / "theirs.jsonl", tmp_path / "runs", tmp_path / "team.json"
    for seed in range(3):
        # The same technique, options and seeds as ours, with other results: from another machine, say.
        result(theirs, "ps-dqn", seed, [40, 42], steps=400)
        folder(runs / str(seed), "pqn", seed, [5, 7])
    team.write_text(evaluation([60, 66, 63], controller="mine").model_dump_json())
    board = leaderboard([records], {}, [theirs, runs, team])
    order = [(entry.rank, entry.system, entry.source, entry.kind) for entry in board.entries]
    assert order == [
        (None, "mine", "team.json", "one team"),
        (1, "ps-dqn", "theirs.jsonl", "trained"),
        (2, "iql", "robosim", "trained"),
        (3, "ps-dqn learning_rate=0.001", "robosim", "trained"),
        (4, "lanes", "robosim", "scripted"),
        (5, "ps-dqn learning_rate=0.1", "robosim", "trained"),
        (6, "pqn", "runs", "trained"),
    ]
    assert board.entries[0].pellets == estimate(mean, np.array([60.0, 66.0, 63.0]))


def test_records_of_one_name_in_two_folders_both_count(records, tmp_path):
    paths = [tmp_path / name for name in ("one/theirs.jsonl", "other/theirs.jsonl", "robosim")]
    for number, path in enumerate(paths):
        path.parent.mkdir(exist_ok=True)
        for seed in range(3):
            result(path, "pqn", seed, [50 + number, 50 + number], steps=400)
    found = [entry for entry in leaderboard([records], {}, paths).entries if entry.system == "pqn"]
    assert [entry.source for entry in found] == [str(path) for path in reversed(paths)]
    assert len(rows(leaderboard([records], {}, paths))) == 5


def test_a_file_that_is_given_by_two_paths_counts_once(records, tmp_path):
    path = tmp_path / "theirs.jsonl"
    for seed in range(3):
        result(path, "pqn", seed, [50, 50])
    (tmp_path / "link.jsonl").symlink_to(path)
    once = leaderboard([records], {}, [path])
    again = [tmp_path / "link.jsonl", path, path]
    assert rows(leaderboard([records], {}, again)).keys() == rows(once).keys()
    assert len(leaderboard([records], {}, again).entries) == len(once.entries)


def test_a_training_of_a_strange_length_is_a_sentence(records, tmp_path):
    theirs = tmp_path / "theirs.jsonl"
    result(theirs, "pqn", 0, [5, 7], steps=400)
    theirs.write_text(theirs.read_text().replace('"steps":400', '"steps":"many"'))
    rekey(theirs)
    with pytest.raises(
        InputError, match=r'theirs\.jsonl .*: steps is "many", but must be a whole number from'
    ):
        leaderboard([records], {}, [theirs])


def test_a_policy_that_ships_stands_beside_with_the_share_on_its_card():
    card = read_card(find_policy("paper-4") / CARD_FILE)
    (entry,) = leaderboard([], {"paper-4": card, "none": card.changed(evaluation=None)}).entries
    assert (entry.rank, entry.system, entry.kind) == (None, "paper-4", "one team")
    assert entry.steps == card.training.steps
    assert entry.pellets.value == pytest.approx(card.evaluation.mean)
    assert entry.share == pytest.approx(card.share)


def test_a_finished_team_that_was_evaluated_several_times_has_no_rank(records):
    for seed in range(3):
        result(records, "policy:any", seed, [40 + seed, 44], learned=False)
    found = rows(leaderboard([records], {}))["any"]
    assert (found.rank, found.kind, found.seeds, found.episodes) == (None, "one team", 1, 6)
    assert found.pellets == estimate(mean, np.array([40.0, 44.0, 41.0, 44.0, 42.0, 44.0]))


def test_lanes_of_ones_own_are_the_measure_where_there_are_no_others(tmp_path):
    theirs = tmp_path / "theirs.jsonl"
    for seed in range(3):
        result(theirs, "lanes", seed, [10, 10], learned=False)
        result(theirs, "pqn", seed, [5, 5])
    found = rows(leaderboard([], {}, [theirs]))
    assert {name: entry.share for name, entry in found.items()} == {"lanes": 1.0, "pqn": 0.5}


def test_a_record_without_pellets_is_a_sentence(tmp_path):
    theirs = tmp_path / "theirs.jsonl"
    result(theirs, "pqn", 0, [5, 7])
    theirs.write_text(theirs.read_text().replace('"pellets"', '"pallets"'))
    with pytest.raises(InputError, match=r"theirs\.jsonl .*: figures must hold pellets, a number for each"):
        leaderboard([], {}, [theirs])


def test_wheel_actions_are_named_wherever_they_are(records):
    for seed in range(3):
        result(records, "pqn", seed, [50, 50], actions="wheels")
    assert "pqn actions=wheels" in rows(leaderboard([records], {}))
    for seed in range(3):
        result(records, "pqn", seed, [60, 60])
    assert {"pqn actions=wheels", "pqn actions=cardinal"} < set(rows(leaderboard([records], {})))


def test_the_search_for_settings_is_not_ranked():
    assert any(path.name == "grid.results.jsonl" for path in committed_records())
    assert all("tuning" not in path.name for path in committed_records())


def test_an_arena_of_another_text_under_the_same_name_is_refused(records, tmp_path):
    card = read_card(find_policy("paper-4") / CARD_FILE)
    text = card.env.arena + "# mine\n"
    known = card.arena.changed(sha256=fingerprint(text))
    other = card.changed(env=card.env.changed(arena=text), arena=known)
    with pytest.raises(InputError, match='two different arenas named "paper": they cannot be compared'):
        leaderboard([records], {"mine": other})


def test_the_committed_records_hold_what_the_board_says_of_them():
    board = leaderboard(committed_records(), {})
    runs = read_runs(committed_records())
    task = Task("paper", "physics", 5000, 8)
    entry = rows(board, task)["ps-pqn"]
    scores = [run.score("pellets") for run in runs if run.task == task and run.technique == "ps-pqn"]
    assert entry.pellets.value == pytest.approx(sum(scores) / 3)
    for _, everybody in board.by_task():
        entries = [entry for entry in everybody if entry.kind != "one team"]
        measured = {entry.system for entry in everybody} - {entry.system for entry in entries}
        assert measured <= {"any", "paper-8"}
        ranks = [entry.rank for entry in entries]
        assert ranks == list(range(1, len(ranks) + 1))
        values = [entry.pellets.value for entry in entries]
        assert values == sorted(values, reverse=True)
        assert min(entry.seeds for entry in entries) >= 3
