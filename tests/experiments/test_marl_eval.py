"""What marl-eval reads: `check` asks what `DiagnoseData` of id-marl-eval 0.0.4 asks, and more."""

from dataclasses import replace

import numpy as np
import pytest

from robosim.errors import InputError
from robosim.experiments.marl_eval import POINTS, marl_eval_tables
from robosim.experiments.runs import Curve, Run, Task

CURVE = Curve(np.array([100.0, 200.0, 400.0]), np.array([10.0, 30.0, 5.0]))


def run(system, seed, robots=2, pellets=(3.0, 5.0), curve=CURVE, **figures):
    learned = {"algorithm": "dqn"} if curve is not None else {}
    task = Task("paper", "grid", 500, robots)
    return Run(
        f"{system}-{seed}", system, task, seed, {"pellets": pellets, **figures}, curve=curve, options=learned,
        system=system,
    )  # fmt: skip


def check(tables, metric):
    """Assert that every system has the same tasks, runs, steps and metrics, and return how many of them."""
    sizes = set()
    for tasks in tables.values():
        assert len({tuple(sorted(systems)) for systems in tasks.values()}) == 1
        for systems in tasks.values():
            for name, runs in systems.items():
                assert "," not in name
                for steps in runs.values():
                    *points, last = steps.items()
                    assert last[0] == "absolute_metrics"
                    assert list(last[1]) == [metric]
                    assert [list(point) for _, point in points] == [["step_count", metric]] * len(points)
                    assert all(isinstance(point[metric], list) for _, point in points)
                    sizes.add((len(runs), tuple(runs), tuple((key, p["step_count"]) for key, p in points)))
    ((count, _, points),) = sizes
    return count, len(points)


def test_every_run_has_its_curve_and_its_evaluation():
    given = [run("a", 0), run("a", 1), run("b", 0), run("b", 1)]
    tables, notes = marl_eval_tables(given, "pellets")
    assert notes == []
    assert check(tables, "pellets") == (2, POINTS)
    steps = tables["paper-grid-500"]["2-robots"]["a"]["run_1"]
    assert steps["absolute_metrics"] == {"pellets": [3.0, 5.0]}
    # The first twentieth of 400 decisions: 10 pellets in 1000, so 5 in an episode.
    assert steps["step_1"] == {"step_count": 20, "pellets": [pytest.approx(5.0)]}
    assert steps["step_20"] == {"step_count": 400, "pellets": [pytest.approx(2.5)]}


def test_what_does_not_learn_is_the_same_at_every_step():
    tables, notes = marl_eval_tables([run("a", 0), run("lanes", 0, curve=None, pellets=(9.0,))], "pellets")
    assert notes == []
    assert check(tables, "pellets") == (1, POINTS)
    steps = tables["paper-grid-500"]["2-robots"]["lanes"]["run_1"]
    assert {tuple(step["pellets"]) for step in steps.values()} == {(9.0,)}


def test_other_figures_have_one_step():
    tables, _ = marl_eval_tables([run("a", 0, touches=(1.0,)), run("b", 0, touches=(2.0,))], "touches")
    assert check(tables, "touches") == (1, 1)


def test_unequal_runs_are_cut_to_equal_ones_and_that_is_said():
    given = [
        *(run("a, b", seed, robots) for seed in range(3) for robots in (2, 4)),
        *(run("c", seed, robots) for seed in range(2) for robots in (2, 4)),
        run("d", 0, 2),
    ]
    tables, notes = marl_eval_tables(given, "pellets")
    assert check(tables, "pellets") == (2, POINTS)
    assert list(tables["paper-grid-500"]["4-robots"]) == ["a; b", "c"]
    assert notes == [
        "--marl-eval: paper-grid-500 leaves out d, since they lack runs of some tasks.",
        "--marl-eval: paper-grid-500 has the first 2 seeds of each system, the fewest there are.",
    ]


def test_a_finished_team_does_not_leave_one_run_of_every_other_system():
    runs = [run("iql", seed) for seed in range(3)]
    team = replace(run("policy:any", 0, curve=None), team="policy:any")
    tables, notes = marl_eval_tables([*runs, team], "pellets")
    assert check(tables, "pellets")[0] == 3
    assert notes == ["--marl-eval: paper-grid-500 leaves out policy:any, a finished team: it is one run."]
    # Beside systems of one run it stays.
    tables, notes = marl_eval_tables([runs[0], team], "pellets")
    assert check(tables, "pellets")[0] == 1
    assert not notes
    (systems,) = (tasks["2-robots"] for tasks in tables.values())
    assert list(systems) == ["iql", "policy:any"]


def test_curves_end_with_the_shortest():
    short = Curve(np.array([100.0]), np.array([10.0]))
    tables, notes = marl_eval_tables([run("a", 0), run("b", 0, curve=short)], "pellets")
    assert check(tables, "pellets") == (1, POINTS)
    assert tables["paper-grid-500"]["2-robots"]["a"]["run_1"]["step_20"]["step_count"] == 100
    assert notes == ["--marl-eval: paper-grid-500 has curves up to decision 100, where the shortest ends."]


def test_systems_without_a_common_task_are_a_sentence():
    with pytest.raises(InputError) as caught:
        marl_eval_tables([run("a", 0, 2), run("b", 0, 4)], "pellets")
    assert str(caught.value) == (
        "--marl-eval: no system has runs in all tasks of an arena, as marl-eval needs."
    )
