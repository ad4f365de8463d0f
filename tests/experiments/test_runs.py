import itertools
import json
import subprocess
import sys

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.cli.main import main
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.envs.config import EnvConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.experiments import runs as module
from robosim.experiments.jobs import run_job
from robosim.experiments.results import append_result, this_machine
from robosim.experiments.runs import Curve, Task, read_runs
from robosim.experiments.team import Measuring, learning_job, measuring_job, work_off
from robosim.learning import folder as names
from robosim.learning.config import run_config
from robosim.learning.trainer import train
from tests.experiments import made

TASK = Task("paper", "grid", 300, 2)


def test_files_are_named_as_a_run_names_them():
    assert (module.EVALUATION_FILE, module.METRICS_FILE) == (names.EVALUATION_FILE, names.METRICS_FILE)


def test_a_training_is_read_as_it_was(tmp_path):
    config = run_config(
        "iql+s", arena="single-lane", robots=1, steps=12, num_envs=1, episode_steps=8, warmup=4, hidden=(8,),
        evaluation_steps=2, evaluation_episodes=2, seed=5,
    )  # fmt: skip
    result = train(config, tmp_path / "deep" / "run", lambda row: None)
    (run,) = read_runs([tmp_path])
    assert run.technique == run.system == "iql+s"
    assert run.seed == 5
    assert run.task == Task(load_arena("single-lane").name, "physics", 2, 1)
    assert run.figures["pellets"] == result.evaluation.totals
    assert run.figures["touches"] == result.evaluation.collisions
    assert run.delivered == result.evaluation.delivered
    assert run.curve.steps[-1] == 12
    assert run.options["hidden"] == [8]
    assert run.options["reward"] == "local"
    assert run.options["steps"] == 12
    assert not {"arena", "world", "robots", "seed", "workers"} & run.options.keys()


def test_records_of_a_sweep_are_read_as_they_were(tmp_path):
    config = run_config(
        "iql+s", arena="paper", world="grid", robots=2, steps=40, num_envs=2, episode_steps=20, warmup=4,
        hidden=(8,), seed=5,
    )  # fmt: skip
    measuring = Measuring(episodes=2, steps=100)
    scripted = EnvConfig(arena="paper", world="grid", robots=2)
    jobs = learning_job(config, measuring), measuring_job("lanes", scripted, 5, measuring)
    results = [run_job(job, work_off, tmp_path / "work") for job in jobs]
    for result in results:
        append_result(tmp_path / "sweep.jsonl", result)
    learned, lanes = read_runs([tmp_path / "sweep.jsonl"])
    assert [(run.system, run.seed, run.task) for run in (learned, lanes)] == [
        ("iql+s", 5, Task("paper", "grid", 100, 2)),
        ("lanes", 5, Task("paper", "grid", 100, 2)),
    ]
    assert learned.curve.steps.tolist() == list(results[0].series["learned"])
    assert lanes.curve is None
    for run, result in zip((learned, lanes), results, strict=True):
        assert run.figures == result.figures
        assert run.score("pellets") == np.mean(result.figures["pellets"])
        assert tuple(map(sum, run.delivered)) == result.figures["pellets"]
        assert run.by_then[-1] == result.figures["pellets"][0]
        assert run.machine == this_machine()
    assert lanes.score("pellets") > 0.0


def test_folders_results_and_evaluations_are_one_kind_of_run(tmp_path):
    made.folder(tmp_path / "runs" / "a", "iql+s", 0, [4, 6], rate=0.02)
    made.result(tmp_path / "sweep.jsonl", "iql+s", 1, [9, 9], steps=made.STEPS)
    made.result(tmp_path / "sweep.jsonl", "lanes", 0, [12, 14], learned=False)
    (tmp_path / "lanes.json").write_text(
        made.evaluation([13, 13], controller="lanes", seed=1).model_dump_json()
    )
    found = read_runs([tmp_path / "runs", tmp_path / "sweep.jsonl", tmp_path / "lanes.json"])
    assert [(run.task, run.technique, run.seed) for run in found] == [
        (TASK, "iql+s", 0),
        (TASK, "iql+s", 1),
        (TASK, "lanes", 0),
        (TASK, "lanes", 1),
    ]
    assert [run.score("pellets") for run in found] == [5.0, 9.0, 13.0, 13.0]
    assert [list(map(sum, run.delivered)) for run in found] == [[4, 6], [9, 9], [12, 14], [13, 13]]
    assert found[1].machine == {"processor": "x"}
    assert found[1].curve.pellets.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert list(found[2].by_then) == [3.0, 6.0, 9.0, 12.0]
    assert found[0].score("gini") is None


def test_a_system_is_named_by_what_differs_within_a_task(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4], learning_rate=0.001)
    made.folder(tmp_path / "b", "iql+s", 0, [5], learning_rate=0.0002)
    made.folder(tmp_path / "c", "ps-dqn", 0, [6])
    # The length of its training differs from task to task alone.
    made.folder(tmp_path / "d", "ps-dqn", 0, [7], robots=4, num_envs=2)
    assert [(run.task.robots, run.system) for run in read_runs([tmp_path])] == [
        (2, "iql+s learning_rate=0.0002"),
        (2, "iql+s learning_rate=0.001"),
        (2, "ps-dqn"),
        (4, "ps-dqn"),
    ]


def test_a_team_that_draws_its_actions_is_another_system(tmp_path):
    made.folder(tmp_path / "a", "ps-dqn", 0, [4])
    made.folder(tmp_path / "b", "ps-dqn", 0, [5], temperature=0.5)
    assert [run.system for run in read_runs([tmp_path])] == [
        "ps-dqn temperature=0.5",
        "ps-dqn temperature=none",
    ]
    made.folder(tmp_path / "c", "ps-dqn", 0, [6], temperature=0.5, temperature_in_place=2.0)
    assert [run.system for run in read_runs([tmp_path / "b", tmp_path / "c"])] == [
        "ps-dqn temperature_in_place=2",
        "ps-dqn temperature_in_place=none",
    ]


def test_what_is_none_by_default_tells_systems_apart(tmp_path):
    """A configuration that lacks an option has it at none."""
    made.folder(tmp_path / "a", "ps-dqn", 0, [4])
    made.folder(tmp_path / "b", "ps-dqn", 0, [4], touch_cost=0.3)
    assert [run.system for run in read_runs([tmp_path])] == [
        "ps-dqn touch_cost=0.3",
        "ps-dqn touch_cost=none",
    ]
    path = tmp_path / "results.jsonl"
    made.result(path, "ps-dqn", 0, [4])
    made.result(path, "ps-dqn", 1, [5], random_arenas=10)
    varied, alone = (run.system for run in read_runs([path]))
    assert varied.startswith(
        "ps-dqn arenas= random_arenas=10 arena_seed=0 random_share=0.5 team_sizes=1x2x4x8"
    )
    assert alone.startswith("ps-dqn arenas=none random_arenas=none arena_seed=none random_share=none")


def test_values_that_begin_alike_stay_apart(tmp_path):
    where = f"/a/{'long' * 12}/"
    for number, name in enumerate("ab"):
        made.folder(tmp_path / name, "ps-dqn", 0, [4 + number], start_from=where + name)
    first, second = (run.system for run in read_runs([tmp_path]))
    assert first[:46] == second[:46] == f"ps-dqn start_from={where[:28]}"
    assert first != second
    assert len(first) == len("ps-dqn start_from=") + 40


def test_teams_of_other_weights_and_scripts_that_keep_a_distance_are_other_systems(tmp_path):
    path = tmp_path / "results.jsonl"
    for number, options in enumerate(({}, {"weights": "ab"}, {"weights": "cd"})):
        made.result(path, "policy:x", number, [4 + number], learned=False)
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        lines[-1]["config"] |= options
        lines[-1]["config"]["env"] |= {} if options else {"keep_distance": 0.3}
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    made.rekey(path)
    assert [run.system for run in read_runs([path])] == [
        "policy:x keep_distance=0.3",
        "policy:x keep_distance=none weights=ab",
        "policy:x keep_distance=none weights=cd",
    ]


def test_lists_and_switches_are_named_without_spaces_and_commas(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4], hidden=(8, 16), mask=True)
    made.folder(tmp_path / "b", "iql+s", 0, [5], hidden=(8,), mask=False)
    assert [run.system for run in read_runs([tmp_path])] == [
        "iql+s hidden=8 mask=false",
        "iql+s hidden=8x16 mask=true",
    ]


def test_a_run_given_twice_counts_once_and_two_that_contradict_are_refused(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4])
    assert len(read_runs([tmp_path, tmp_path / "a"])) == 1
    made.folder(tmp_path / "b", "iql+s", 0, [5])
    with pytest.raises(InputError) as caught:
        read_runs([tmp_path])
    assert str(caught.value) == (
        f"{tmp_path}/a and {tmp_path}/b are both iql+s with seed 0 in {TASK}, "
        "but with other results: give one of them."
    )


def test_runs_that_bring_nothing_are_not_one_for_that(tmp_path):
    for name, touches in (("a", [3.0, 5.0]), ("b", [3.0]), ("c", [4.0])):
        made.result(tmp_path / name, "iql+s", 0, [0] * len(touches))
        line = json.loads((tmp_path / name).read_text())
        line["figures"]["touches"] = touches
        (tmp_path / name).write_text(json.dumps(line) + "\n")
    assert len(read_runs([tmp_path / "a", tmp_path / "b"])) == 1
    for other in "ab":
        with pytest.raises(InputError, match="but with other results"):
            read_runs([tmp_path / "c", tmp_path / other])


def test_an_evaluation_that_goes_on_from_another_takes_its_place(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4, 6])
    made.folder(tmp_path / "b", "iql+s", 0, [4, 6, 5])
    made.folder(tmp_path / "c", "iql+s", 0, [4])
    for order in itertools.permutations("abc"):
        (run,) = read_runs([tmp_path / one for one in order])
        assert list(run.figures["pellets"]) == [4, 6, 5]
        assert run.source == f"{tmp_path}/b"
    made.folder(tmp_path / "d", "iql+s", 0, [4, 7])
    for other in "ab":
        with pytest.raises(InputError, match="but with other results"):
            read_runs([tmp_path / "d", tmp_path / other])
    assert len(read_runs([tmp_path / "c", tmp_path / "d"])) == 1


def test_arenas_of_one_name_must_be_one(tmp_path):
    text = load_arena("paper").text
    (tmp_path / "other.toml").write_text(text.replace("[", "# Another arena of this name.\n[", 1))
    made.folder(tmp_path / "a", "iql+s", 0, [4])
    made.folder(tmp_path / "b", "iql+s", 1, [4], arena=str(tmp_path / "other.toml"))
    with pytest.raises(InputError) as caught:
        read_runs([tmp_path])
    assert str(caught.value) == (
        f'{tmp_path}/a and {tmp_path}/b have two different arenas named "paper": they cannot be compared.'
    )


SLIGHT = 'name = "slight"\n[sensing]\ndropout = 0.1\n'


def test_runs_under_different_profiles_are_not_one_system_in_one_task(tmp_path):
    """What teams learned under makes the system, what they were measured under the task."""
    made.folder(tmp_path / "a", "iql+s", 0, [4])
    made.folder(tmp_path / "b", "iql+s", 0, [5], profile="mocap")
    made.folder(tmp_path / "c", "iql+s", 0, [6], profile="none", under="none")
    made.folder(tmp_path / "d", "iql+s", 1, [7], under="mocap")
    made.result(tmp_path / "sweep.jsonl", "iql+s", 1, [8], steps=made.STEPS, under=SLIGHT)
    made.result(tmp_path / "sweep.jsonl", "lanes", 0, [9], learned=False, under="mocap")
    (tmp_path / "lanes.json").write_text(made.evaluation([10], controller="lanes", seed=0).model_dump_json())
    # With none, and with one that changes nothing, is the same: "c" contradicts "a" unless it is left out.
    with pytest.raises(InputError, match="but with other results"):
        read_runs([tmp_path / name for name in "abc"])
    found = read_runs([tmp_path / name for name in ("a", "b", "d", "sweep.jsonl", "lanes.json")])
    assert [(run.task.profile, run.system, run.seed, run.score("pellets")) for run in found] == [
        ("", "iql+s profile=mocap", 0, 5.0),
        ("", "iql+s profile=none", 0, 4.0),
        ("", "lanes", 0, 10.0),
        ("mocap", "iql+s profile=none", 1, 7.0),
        ("mocap", "lanes", 0, 9.0),
        ("slight", "iql+s profile=none", 1, 8.0),
    ]
    assert str(found[3].task) == f"{TASK}, under mocap"


def test_profiles_of_one_name_must_be_one(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4], under=SLIGHT)
    made.folder(tmp_path / "b", "iql+s", 1, [4], under=SLIGHT.replace("0.1", "0.2"))
    with pytest.raises(InputError) as caught:
        read_runs([tmp_path])
    assert str(caught.value) == (
        f'{tmp_path}/a and {tmp_path}/b have two different profiles named "slight": they cannot be compared.'
    )


def test_so_must_those_that_teams_learned_under(tmp_path):
    for name, text in (("a", SLIGHT), ("b", SLIGHT.replace("0.1", "0.2"))):
        made.folder(tmp_path / name, "iql+s", 0, [4], profile=text)
    with pytest.raises(InputError, match='two different profiles named "slight"'):
        read_runs([tmp_path])


def test_sizes_of_one_noise_are_told_apart(tmp_path):
    for name, dropout in (("a", 0.1), ("b", 0.2)):
        made.folder(tmp_path / name, "iql+s", 0, [4], profile=SLIGHT, sensing_dropout=dropout)
    assert [run.system for run in read_runs([tmp_path])] == [
        "iql+s sensing_dropout=0.1",
        "iql+s sensing_dropout=0.2",
    ]


def damage(path, how):
    if how == "no evaluation":
        (path / "evaluation.json").unlink()
    if how == "not finished":
        (path / "evaluation.json").unlink()
        (path / "finished.json").unlink()
    if how == "evaluation":
        (path / "evaluation.json").write_text("[]")
    if how == "field":
        table = json.loads((path / "evaluation.json").read_text()) | {"robots": 0}
        (path / "evaluation.json").write_text(json.dumps(table))
    if how == "config":
        (path / "config.toml").write_text("[run]\nseed = 1\n")
    if how == "syntax":
        (path / "config.toml").write_text("[run\n")
    if how == "metrics":
        (path / "metrics.parquet").write_text("no metrics")


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        (
            "no evaluation",
            (
                "{0}: this run has no evaluation (evaluation.json): it was trained without; "
                "`robosim evaluate {0} --json FILE` makes one."
            ),
        ),
        (
            "not finished",
            "{0}: this run has no evaluation (evaluation.json): `robosim train --resume {0}` goes on with it",
        ),
        ("evaluation", "{}/evaluation.json: this is not the evaluation of a run."),
        ("field", "{}/evaluation.json: robots is 0, but must be a whole number from 1 to 1000."),
        ("config", "{}/config.toml: env is None, but must be a table."),
        ("syntax", "{}/config.toml: not a TOML file ("),
        ("metrics", "{}/metrics.parquet: cannot be read as the metrics of a run ("),
    ],
)
def test_a_damaged_run_is_a_sentence(tmp_path, how, sentence):
    path = made.folder(tmp_path / "run", "iql+s", 0, [4])
    # A record without digests, so that what is wrong with the files is looked at.
    (path / "finished.json").write_text('{"steps": 12, "wall_time": 1.0}')
    damage(path, how)
    with pytest.raises(InputError) as caught:
        read_runs([tmp_path])
    assert str(caught.value).startswith(sentence.format(path))


@pytest.mark.parametrize(
    ("part", "name", "value", "sentence"),
    [
        ("series", "learned_pellets", [1.0], "learned_pellets must have a number for each of learned."),
        ("series", "learned", [100.0, 100.0, 300.0, 400.0], "learned must hold numbers above 0 that grow."),
        ("series", "robot_pellets", [1.0] * 3, "robot_pellets must have a number for each of 2 robots."),
        (
            "config",
            "evaluation",
            {"steps": "x"},
            'evaluation.steps is "x", but must be a whole number from 1',
        ),
    ],
)
def test_a_damaged_result_is_a_sentence(tmp_path, part, name, value, sentence):
    path = tmp_path / "results.jsonl"
    made.result(path, "iql+s", 0, [4])
    line = json.loads(path.read_text())
    line[part][name] = value
    path.write_text(json.dumps(line))
    made.rekey(path)
    line = json.loads(path.read_text())
    with pytest.raises(InputError) as caught:
        read_runs([path])
    assert str(caught.value).startswith(f"{path} ({line['key'][:16]}): {sentence}")


def test_run_folders_of_a_sweep_are_left_to_its_results(tmp_path):
    job = tmp_path / "sweep-study" / "0123456789abcdef"
    made.folder(job / "work" / "run", "iql+s", 0, [4])
    (job / "work" / "run" / "evaluation.json").unlink()
    (job / "config.json").touch()
    with pytest.raises(InputError) as caught:
        read_runs([tmp_path])
    assert str(caught.value) == (
        f"{tmp_path}: the runs in this folder are those of a sweep: give its file of results."
    )
    made.folder(tmp_path / "own", "iql+s", 1, [5])
    assert [run.seed for run in read_runs([tmp_path])] == [1]


def test_a_path_without_runs_is_a_sentence(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "none.jsonl").touch()
    (tmp_path / "text.json").write_text('{"a": 1}')
    for name, sentence in {
        "empty": "there is no run in this folder: no config.toml in it or below it.",
        "none.jsonl": "there is no result in this file.",
        "text.json": "line 1 is no result (",
        "nowhere": "there is no such run folder, results file or evaluation.",
    }.items():
        with pytest.raises(InputError) as caught:
            read_runs([tmp_path / name])
        assert str(caught.value).startswith(f"{tmp_path / name}: {sentence}")


def test_a_curve_between_edges_is_what_was_delivered_there():
    curve = Curve(np.array([100.0, 200.0, 400.0]), np.array([10.0, 30.0, 5.0]))
    # 1, 3 and 1 pellets in 100, 100 and 200 decisions.
    assert curve.between(np.array([0.0, 200.0, 400.0])) == pytest.approx([20.0, 5.0])
    assert curve.between(np.array([0.0, 50.0, 150.0])) == pytest.approx([10.0, 20.0])


def test_reading_runs_takes_no_torch(tmp_path):
    made.folder(tmp_path / "a", "iql+s", 0, [4])
    code = (
        "import sys; from pathlib import Path; from robosim.experiments.runs import read_runs; "
        f"runs = read_runs([Path({str(tmp_path)!r})]); "
        "print(len(runs), 'torch' in sys.modules, 'matplotlib' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "1 False False\n"


@pytest.mark.parametrize("name", ["config.toml", "evaluation.json", "metrics.parquet"])
def test_no_bit_of_a_finished_run_changes_unnoticed(tmp_path, name):
    path = made.folder(tmp_path / "run", "iql+s", 0, [4])
    whole = (path / name).read_bytes()
    for bit in np.random.default_rng(1).integers(0, 8 * len(whole), 10).tolist():
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        (path / name).write_bytes(flipped)
        with pytest.raises(InputError) as caught:
            read_runs([tmp_path])
        assert str(caught.value) == f"{path / name}: is not what the run wrote: its SHA-256 is another."


def test_evaluations_of_one_trained_team_are_one_run_and_of_a_script_several(tmp_path):
    files = []
    for name, seeds in (("paper-2", (1, 2, 3)), ("lanes", (1, 2))):
        for seed in seeds:
            env = VectorEnv("paper", robots=2, world="grid", episode_steps=60, num_envs=2)
            found = evaluate(make_controller(name), env, 2, seed)
            files.append(tmp_path / f"{name}-{seed}.json")
            files[-1].write_text(found.model_dump_json())
    by_name = {}
    for run in read_runs([*files, files[0]]):
        by_name.setdefault(run.system, []).append(run)
    (team,) = by_name["paper-2"]
    assert team.seed == 1
    totals = [json.loads(file.read_text())["delivered"] for file in files[:3]]
    assert team.delivered == tuple(tuple(one) for found in totals for one in found)
    assert len(team.figures["pellets"]) == len(team.figures["touches"]) == 6
    assert [run.seed for run in by_name["lanes"]] == [1, 2]


def test_a_finished_team_in_a_sweep_is_one_run_with_the_episodes_of_all_seeds(tmp_path):
    for seed, pellets in ((2, [5, 6]), (1, [7, 8]), (3, [9])):
        made.result(tmp_path / "sweep.jsonl", "policy:any", seed, pellets, learned=False)
    (run,) = read_runs([tmp_path / "sweep.jsonl"])
    assert (run.seed, run.figures["pellets"]) == (1, (7, 8, 5, 6, 9))
    assert list(map(sum, run.delivered)) == [7, 8, 5, 6, 9]


def test_trainings_evaluated_elsewhere_are_seeds_of_one_system(tmp_path):
    """As `robosim evaluate --json` names the run; further episodes of one team are no other seed."""

    def trained(seed, **options):
        config = run_config(
            "iql", **{"arena": "paper-grid", "world": "grid", "robots": 1, **options}, steps=12, num_envs=1,
            episode_steps=8, warmup=4, hidden=(8,), evaluation_steps=10, evaluation_episodes=1, seed=seed,
        )  # fmt: skip
        folder = tmp_path / f"{seed}-{'-'.join(map(str, options.values()))}"
        train(config, folder, lambda row: None)
        return folder

    def evaluated(folder, seed=0, episodes=1):
        file = tmp_path / f"{folder.name}-{seed}.json"
        where = ["--arena", "long", "--world", "grid", "--steps", "10", "--seed", str(seed)]
        assert main(["evaluate", str(folder), *where, "--episodes", str(episodes), "--json", str(file)]) == 0
        return file

    first, second = trained(0), trained(1)
    files = [evaluated(first, 0), evaluated(first, 5, 2), evaluated(second)]
    runs = read_runs(files)
    assert [(run.system, run.seed, len(run.delivered)) for run in runs] == [("iql", 0, 3), ("iql", 1, 1)]
    assert runs[0].task == Task("long", "grid", 10, 1)
    elsewhere = evaluated(trained(0, arena="long"))
    systems = {run.system for run in read_runs([*files, elsewhere])}
    assert systems == {"iql trained_in=paper-grid-grid-1", "iql trained_in=long-grid-1"}
    # Beside the run itself the evaluation of its team is no second one.
    own = trained(0, robots=2)
    again = tmp_path / "again.json"
    assert main(["evaluate", str(own), "--steps", "10", "--episodes", "2", "--json", str(again)]) == 0
    (run,) = read_runs([own, again])
    assert run.source == str(own)
