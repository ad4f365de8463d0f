import signal
from dataclasses import asdict

import pytest
from rerun.chunk import RrdReader

from robosim.cli.main import main, parse
from robosim.cli.program import hint
from robosim.envs.variety import VarietyConfig
from robosim.errors import InputError
from robosim.learning.config import read_config
from robosim.learning.training import Training

TINY = [
    "--steps", "240", "--num-envs", "2", "--episode-steps", "60", "--warmup", "40", "--hidden", "8", "8",
    "--evaluation-episodes", "1", "--evaluation-steps", "20",
]  # fmt: skip
UNEVALUATED = ["--evaluation-episodes", "0", "--evaluation-steps", "0"]


def test_a_run_records_playbacks_while_it_learns(tmp_path, capsys):
    folder = tmp_path / "run"
    options = ["--record-every", "120", "--record-steps", "20", "--technique", "smadrl", "--robots", "3"]
    assert main(["train", "--out", str(folder), *TINY, *options]) == 0
    assert "240 joint decisions" in capsys.readouterr().out
    recordings = sorted((folder / "recordings").iterdir())
    assert [path.name for path in recordings] == ["000000000120.rrd", "000000000240.rrd"]
    # After the first stage there are two robots, at the end three.
    for path, robots in zip(recordings, (2, 3), strict=True):
        entities = {str(chunk.entity_path) for chunk in RrdReader(str(path)).stream()}
        named = {entity.split("/robots/")[1].split("/")[0] for entity in entities if "/robots/" in entity}
        assert len(named) == robots, sorted(entities)


def test_without_options_it_is_the_default_technique():
    command = parse(["train"])
    assert (command.technique, command.env_options.robots) == ("ps-dqn", 2)
    # An option whose value has been forgotten at the end is the parser's to complain of.
    with pytest.raises(InputError, match="Missing value for argument '--technique'"):
        parse(["train", "--technique"])


def test_resume_takes_no_other_options_and_needs_a_run(tmp_path, capsys):
    assert main(["train", "--resume", str(tmp_path), "--robots", "3"]) == 2
    assert capsys.readouterr().err == (
        "robosim: --resume goes on with a run as it was configured: --robots cannot be given with it.\n"
    )
    # Also what is the default: the run may have been configured otherwise.
    for option in (["--steps", "30000"], ["--no-curriculum"], ["--technique=ps-dqn"]):
        assert main(["train", *option, f"--resume={tmp_path}"]) == 2
        assert capsys.readouterr().err == (
            "robosim: --resume goes on with a run as it was configured: "
            f"{option[0].partition('=')[0]} cannot be given with it.\n"
        )
    assert main(["train", "--resume", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"robosim: {tmp_path}: no run to resume: there is no config.toml in it.\n"
    )


def test_it_says_how_many_decisions_were_taken_and_not_how_many_were_asked_for(tmp_path, capsys):
    options = ["--steps", "9", *UNEVALUATED]
    assert main(["train", "--out", str(tmp_path / "run"), *TINY, *options]) == 0
    assert "\n10 joint decisions in " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            ["--technique=ia2c", "--epsilon-start", "0.1"],
            "--epsilon-start is an option of the algorithm dqn: technique ia2c learns by ia2c.",
        ),
        (["--name", "ia2c"], "Unrecognized options: --name, ia2c; see robosim train --help."),
        (
            ["--technique", "a", "--technique", "iql+gss"],
            'unknown technique "iql+gss": did you mean iql+gs or iql+s or iql+g?',
        ),
    ],
)
def test_an_option_that_there_is_not_is_a_sentence(options, sentence, capsys):
    assert main(["train", *options]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"


@pytest.mark.parametrize(
    ("options", "idle", "needed"),
    [
        (["--fine-tune", "0.5"], "--fine-tune", "--curriculum"),
        (["--technique", "smadrl", "--no-curriculum", "--newcomer", "copy"], "--newcomer", "--curriculum"),
        (["--no-stigmergy", "--pheromone-radius", "1"], "--pheromone-radius", "--stigmergy"),
        (["--record-steps", "9"], "--record-steps", "--record-every"),
        (["--arenas", "paper", "--random-share", "0.9"], "--random-share", "--random-arenas"),
    ],
)
def test_an_option_that_changes_nothing_is_refused(options, idle, needed, tmp_path, capsys):
    folder = tmp_path / "run"
    assert main(["train", "--out", str(folder), *options]) == 2
    said = f"robosim: {idle} changes nothing without {needed}: leave it out, or give both."
    assert capsys.readouterr().err.splitlines()[-1] == said
    assert not folder.exists()


@pytest.mark.parametrize(
    ("options", "idle", "why"),
    [
        (
            ["--start-from", "paper-2", "--robots", "2", "--exploration", "0.5"],
            "--exploration",
            "with --start-from, a team explores as at its end",
        ),
        (
            [
                "--technique",
                "smadrl",
                "--newcomer",
                "copy",
                "--start-from",
                "paper-2",
                "--epsilon-start",
                "0.5",
            ],
            "--epsilon-start",
            "with --start-from, a team explores as at its end",
        ),
        (
            ["--technique", "smadrl", "--start-from", "paper-2", "--first-team", "3"],
            "--first-team",
            "with --start-from, that team is the first",
        ),
        (
            ["--evaluation-episodes", "0", "--evaluation-steps", "9"],
            "--evaluation-steps",
            "there are no episodes of evaluation",
        ),
        (["--technique", "vdn", "--mixer-width", "8"], "--mixer-width", "a sum of values has no networks"),
    ],
)
def test_an_option_that_changes_nothing_beside_another_is_refused(options, idle, why, tmp_path, capsys):
    folder = tmp_path / "run"
    assert main(["train", "--out", str(folder), *options]) == 2
    said = f"robosim: {idle} changes nothing here: {why}. Leave it out."
    assert capsys.readouterr().err.splitlines()[-1] == said
    assert not folder.exists()


def test_the_folder_says_in_which_world_a_team_learned(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = ["--steps", "4", *UNEVALUATED, "--robots", "1", "--technique", "iql"]
    for world in ("physics", "grid"):
        assert main(["train", "--arena", "paper-grid", "--world", world, *TINY, *options]) == 0
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {
        "paper-grid-1-iql-0",
        "paper-grid-1-iql-0-grid",
    }


def test_an_option_counts_where_it_is_what_teams_without_wheels_have(tmp_path):
    options = ["--actions", "wheels", "--robots", "8", "--discount", "0.95", "--updates-per-step=0.5"]
    assert main(["train", "--out", str(tmp_path / "run"), *TINY, *options]) == 0
    algorithm = read_config(tmp_path / "run" / "config.toml").algorithm
    assert (algorithm.discount, algorithm.learning_rate, algorithm.updates_per_step) == (0.95, 3e-3, 0.5)


def test_without_options_it_is_the_default_technique_in_the_default_arena():
    given = parse(["train", "--technique", "ps-dqn", "--arena", "paper"])
    assert asdict(parse(["train"])) == asdict(given)


def test_a_policy_to_start_from_must_exist_and_fit(tmp_path, capsys):
    options = ["train", "--out", str(tmp_path / "run"), *TINY]
    assert main([*options, "--start-from", "nobody"]) == 2
    assert "no policy is named 'nobody'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_device_that_is_not_there_is_a_sentence(tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path / "run"), *TINY, "--device", "tpu"]) == 2
    assert capsys.readouterr().err == 'robosim: device is "tpu", but must be "cpu", or "cuda" for a GPU.\n'


def test_a_network_learns_in_several_arenas_with_several_team_sizes(tmp_path, capsys):
    several = [
        "--arenas",
        "paper",
        "s-bend",
        "--random-arenas",
        "3",
        "--team-sizes",
        "1",
        "2",
        "--num-envs",
        "4",
    ]
    assert main(["train", "--out", str(tmp_path / "run"), *TINY, *several]) == 0
    assert read_config(tmp_path / "run" / "config.toml").variety == VarietyConfig(
        arenas=("paper", "s-bend"), random_arenas=3, team_sizes=(1, 2)
    )
    capsys.readouterr()
    assert main(["train", "--team-sizes", "3"]) == 2
    assert capsys.readouterr().err == (
        "robosim: variety: arenas is empty and random_arenas is 0, but one of them must be there.\n"
    )


def test_the_same_command_may_be_given_again_until_the_run_is_finished(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "run"
    command = ["train", "--out", str(folder), "--resume-if-present", *TINY, "--checkpoint-every", "120"]
    advance = Training.advance

    def stopping(training, beside=None):
        if training.step == 180:
            signal.raise_signal(signal.SIGTERM)  # as a cluster ends a job that it needs the place of
        return advance(training, beside)

    with monkeypatch.context() as patched:
        patched.setattr(Training, "advance", stopping)
        assert main(command) == 130
    assert f"Stopped; go on with: {hint('train', '--resume', folder)}" in capsys.readouterr().out
    assert main(command) == 0
    shown = capsys.readouterr()
    assert "240 joint decisions" in shown.out
    assert shown.err == ""
    assert main(command) == 0
    assert capsys.readouterr().err == f"{folder}: this run is finished; there is nothing left to do.\n"
    assert main([*command, "--seed", "1"]) == 2
    assert capsys.readouterr().err == (
        f"robosim: {folder}: run.seed is 0 in the run that this folder holds, not 1; "
        "a run of its own needs a folder of its own.\n"
    )


def test_a_run_too_short_to_learn_in_says_so(tmp_path, capsys):
    options = ["--steps", "20", *UNEVALUATED]
    assert main(["train", "--out", str(tmp_path / "run"), *TINY, *options]) == 0
    said = capsys.readouterr().err.splitlines()
    more = "; more --steps are needed, or updates that come earlier."
    assert said == [
        f"Nothing was learned: the first update comes after 40 decisions of a stage (warmup){more}"
    ]
    assert main(["train", "--out", str(tmp_path / "other"), *TINY, *options, "--warmup", "4"]) == 0
    assert "Nothing was learned" not in capsys.readouterr().err
    # A rollout of all environments is longer than the run.
    short = ["--technique", "ps-ippo", "--robots", "2", "--num-envs", "32", "--steps", "320"]
    assert main(["train", "--out", str(tmp_path / "third"), *short, "--evaluation-episodes", "0"]) == 0
    assert f"Nothing was learned{more}\n" in capsys.readouterr().err


def test_newcomers_that_learn_nothing_are_named(tmp_path, capsys):
    options = [
        "--technique",
        "smadrl",
        "--robots",
        "4",
        "--steps",
        "400",
        "--warmup",
        "150",
        "--num-envs",
        "2",
    ]
    folder = str(tmp_path / "run")
    assert main(["train", "--out", folder, *options, "--evaluation-episodes", "0"]) == 0
    assert (
        "Nothing was learned in the stages newcomer 3, newcomer 4: the first update comes after 150 decisions"
    ) in capsys.readouterr().err
