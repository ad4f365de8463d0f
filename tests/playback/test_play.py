import json
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from robosim.cli.main import main
from robosim.cli.program import hint
from robosim.envs.vector import VectorEnv
from robosim.episodes.trajectory import load_trajectory
from tests.playback.reading import Reading, plain
from tests.processes import hearing_ctrl_c


def test_play_records_and_says_how_to_open_it(tmp_path, capsys):
    path = tmp_path / "run.rrd"
    arguments = ["play", "lanes", "--arena", "paper", "--robots", "2", "--steps", "20", "--seed", "4"]
    assert main([*arguments, "--save", str(path)]) == 0
    printed = capsys.readouterr().out
    assert f"{path}: 20 decisions, 0 pellets, " in printed
    assert f"open it with: {hint('view', path)}\n" in printed
    reader = RrdReader(path)
    assert (len(reader.recordings()), len(reader.blueprints())) == (1, 1)
    about = {}
    for chunk in reader.stream():
        if chunk.entity_path == "/__properties/robosim":
            batch = chunk.to_record_batch()
            about = {name: batch.column(name).to_pylist()[0] for name in batch.schema.names}
    assert (about["policy"], about["seed"], about["robots"]) == (["lanes"], ["4"], ["2"])


def test_recordings_pass_the_viewers_own_check(tmp_path):
    path = tmp_path / "run.rrd"
    assert main(["play", "random", "--robots", "2", "--steps", "5", "--save", str(path)]) == 0
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0
    assert "1 file verified without error" in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--save", "nowhere/run.rrd"],
            "Recording 'nowhere/run.rrd': cannot be written (No such file or directory)",
        ),
        (["--save", "run.mp4"], "Recording 'run.mp4': the file name must end in .rrd"),
        (["--steps", "0"], "--steps is 0, but must be a whole number from 1 to 100000000."),
        (["--seed", "-1"], "--seed is -1, but must be a whole number from 0 to 18446744073709551615."),
        (
            ["--save-trajectory", "nowhere/run.npz"],
            "nowhere/run.npz: cannot be written: No such file or directory.",
        ),
        (
            ["--save-trajectory", "run.rrd"],
            "run.rrd: cannot be written: the name of a trajectory's file must end in .npz.",
        ),
        (["--robots", "0"], "robots is 0, but must be"),
        (["--video", "run.avi"], "run.avi: the name of a film must end in .mp4, .webp or .gif."),
        (["--video", "nowhere/run.mp4"], "nowhere/run.mp4: cannot be written: No such file or directory."),
        (
            ["--video", "run.webp", "--steps", "4000"],
            "run.webp: would hold 4001 pictures, but may hold 1500: take fewer decisions, a higher speed, or",
        ),
        (["--video", "run.gif", "--speed", "0"], "--speed is 0.0, but must be a number from 0.01 to 1000."),
        (["--video", "run.gif", "--size", "9"], "--size is 9, but must be a whole number from 64 to 3840."),
        (["--speed", "4"], "--speed says how fast a film is: it needs --video or --live."),
        (["--size", "480"], "--size says how large a film is: it needs --video."),
        (
            ["--clogs-only", "--video", "run.gif"],
            "--video shows an episode whole: it cannot be given with --clogs-only.",
        ),
        (["--clogs-only", "--live"], "--live shows an episode whole: it cannot be given with --clogs-only."),
        (
            ["--live", "--view"],
            "--live opens the viewer while the episode runs: --view is not needed with it.",
        ),
        (["--arena", "papr"], "paper"),
    ],
)
def test_wrong_input_is_a_sentence_and_leaves_no_file(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["play", "lanes", *arguments]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint
    assert complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """A folder with a run as live.rrd and as run.npz."""
    folder = tmp_path_factory.mktemp("played")
    command = ["play", "lanes", "--robots", "4", "--steps", "120", "--seed", "6"]
    saved = ["--save", str(folder / "live.rrd"), "--save-trajectory", str(folder / "run.npz")]
    assert main([*command, *saved]) == 0
    return folder


def test_a_saved_trajectory_plays_again_as_the_run_did(tmp_path, capsys, played):
    path, run = tmp_path / "again.rrd", played / "run.npz"
    assert main(["play", str(run), "--save", str(path)]) == 0
    live, again = Reading(played / "live.rrd"), Reading(path)
    delivered = live.rows["/plots/delivered"]["Scalars:scalars"][-1][0]
    assert delivered > 0
    printed = capsys.readouterr().out
    assert f"{path}: 120 decisions, {delivered:.0f} pellets, " in printed
    assert again.rows.keys() == live.rows.keys()
    for entity, rows in again.rows.items():
        assert plain(rows) == plain(live.rows[entity]), entity
    about = again.static["/__properties/robosim"]
    trajectory = load_trajectory(run)
    assert (about["policy"], about["trajectory"]) == (["lanes"], ["run.npz"])
    assert (about["environment_seed"], about["episode"]) == ([str(trajectory.seed)], ["0"])
    assert about["arena_file"] == live.static["/__properties/robosim"]["arena_file"]


def test_where_a_trajectory_lies_is_printed_when_it_is_saved(tmp_path, capsys):
    run = tmp_path / "run.npz"
    command = ["play", "random", "--robots", "2", "--steps", "5", "--save", str(tmp_path / "run.rrd")]
    assert main([*command, "--save-trajectory", str(run)]) == 0
    assert f"run it again with: {hint('play', run)}\n" in capsys.readouterr().out
    trajectory = load_trajectory(run)
    assert (trajectory.chosen.shape, trajectory.policy) == ((5, 2), "random")


def test_steps_cut_a_trajectory(tmp_path, played, capsys):
    path = tmp_path / "again.rrd"
    assert main(["play", str(played / "run.npz"), "--steps", "30", "--save", str(path)]) == 0
    assert f"{path}: 30 decisions, 0 pellets, " in capsys.readouterr().out
    live, again = Reading(played / "live.rrd"), Reading(path)
    steps = np.arange(31)
    for entity, name in [
        ("/arena/robots/3", "Transform3D:translation"),
        ("/arena/pellets/loose", "Points2D:positions"),
    ]:
        assert again.shown(entity, name, steps) == live.shown(entity, name, steps)
        assert again.rows[entity]["step"].max() <= 30


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--arena", "paper"], "--arena cannot be given with {run}: a trajectory runs again just as it was."),
        (["--robots", "4"], "--robots cannot be given with {run}: a trajectory runs again just as it was."),
        (["--world", "grid"], "--world cannot be given with {run}: a trajectory runs again just as it was."),
        (["--seed", "0"], "--seed cannot be given with {run}: a trajectory runs again just as it was."),
        (
            ["--save-trajectory", "other.npz"],
            "--save-trajectory cannot be given with {run}: a trajectory runs again just as it was.",
        ),
        (["--steps", "121"], "--steps is 121: {run} holds 120 decisions."),
        (["--steps", "0"], "--steps is 0, but must be a whole number from 1 to 100000000."),
        (["--save", "run.mp4"], "Recording 'run.mp4': the file name must end in .rrd, the viewer's format."),
    ],
)
def test_what_makes_no_sense_with_a_trajectory_is_refused(
    tmp_path, monkeypatch, capsys, played, options, sentence
):
    monkeypatch.chdir(tmp_path)
    run = played / "run.npz"
    assert main(["play", str(run), *options]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence.format(run=run)}\n"
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_cannot_be_written_is_refused_before_the_trajectory_runs(tmp_path, capsys, played):
    path = tmp_path / "nowhere" / "run.rrd"
    assert main(["play", str(played / "run.npz"), "--save", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"robosim: Recording {str(path)!r}: cannot be written (No such file")
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def _truncated(source, target):
    content = source.read_bytes()
    target.write_bytes(content[: len(content) // 2])


def _damaged(source, target):
    content = bytearray(source.read_bytes())
    place = content.index(b"chosen.npy") + 60
    content[place : place + 20] = bytes(20)
    target.write_bytes(content)


def _foreign(source, target):
    np.savez(target, weights=np.zeros(3))


def _another_arena(source, target):
    _configured(source, target, arena="=")


def _too_many_robots(source, target):
    _configured(source, target, robots=99, chosen=np.zeros((3, 99), dtype=np.uint8))


def _empty(source, target):
    _changed(source, target, chosen=np.zeros((0, 4), dtype=np.uint8))


def _fast_pheromone(source, target):
    _configured(source, target, pheromone={"decay": 3.0})


def _configured(source, target, chosen=None, **fields):
    """Change fields of the configuration."""
    with np.load(source) as file:
        config = json.loads(file["config"].tobytes()) | fields
        chosen = file["chosen"] if chosen is None else chosen
    text = np.frombuffer(json.dumps(config).encode(), dtype=np.uint8)
    _changed(source, target, config=text, chosen=chosen)


def _changed(source, target, **changes):
    with np.load(source) as file:
        np.savez(target, **{**file, **changes})


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda source, target: None, "there is no such trajectory."),
        (lambda source, target: target.mkdir(), "this is a directory; a trajectory is needed here."),
        (lambda source, target: target.write_text("hello"), "is no trajectory (File is not a zip file)."),
        (_truncated, "is no trajectory (File is not a zip file)."),
        (_damaged, "is no trajectory ("),
        (_foreign, "is no trajectory; it lacks format."),
        (_another_arena, "not a TOML file"),
        (_too_many_robots, "robots is 99, but must be a whole number from 1 to 35"),
        (_empty, "it holds no decisions."),
        (_fast_pheromone, "config: pheromone.decay is 3.0, but must be a number from 1e-06 to 1."),
    ],
)
def test_a_file_that_cannot_be_played_is_a_sentence(tmp_path, monkeypatch, capsys, played, spoil, sentence):
    monkeypatch.chdir(tmp_path)
    spoil(played / "run.npz", tmp_path / "bad.npz")
    assert main(["play", "bad.npz"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith(f"robosim: bad.npz: {sentence}")
    assert complaint.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} <= {"bad.npz"}


def _interrupt_at(monkeypatch, decision):
    """Stand for a person who presses Ctrl-C in this decision."""
    step = VectorEnv.step

    def interrupted(env, actions):
        if env.steps_taken == decision:
            raise KeyboardInterrupt
        return step(env, actions)

    monkeypatch.setattr(VectorEnv, "step", interrupted)


def test_an_interrupted_run_keeps_recording_and_trajectory(tmp_path, monkeypatch, capsys):
    path, run = tmp_path / "run.rrd", tmp_path / "run.npz"
    _interrupt_at(monkeypatch, 7)
    command = ["play", "lanes", "--robots", "2", "--steps", "20", "--save", str(path)]
    assert main([*command, "--save-trajectory", str(run)]) == 130
    captured = capsys.readouterr()
    assert f"{path}: 7 decisions, 0 pellets, " in captured.out
    assert captured.err == "robosim: interrupted\n"
    assert Reading(path).rows["/plots/delivered"]["step"].tolist() == [0, 7]
    assert load_trajectory(run).chosen.shape == (7, 2)


def test_a_trajectory_interrupted_as_it_plays_again_is_kept_as_far_as_it_came(
    tmp_path, monkeypatch, capsys, played
):
    path = tmp_path / "again.rrd"
    _interrupt_at(monkeypatch, 11)
    assert main(["play", str(played / "run.npz"), "--save", str(path)]) == 130
    captured = capsys.readouterr()
    assert f"{path}: 11 decisions, 0 pellets, " in captured.out
    assert captured.err == "robosim: interrupted\n"
    assert Reading(path).rows["/plots/delivered"]["step"].tolist() == [0, 11]
    assert list(tmp_path.iterdir()) == [path]


def film_size(path):
    """Return the width, height and pictures of an animation, and how long it is seen, s."""
    with Image.open(path) as animation:
        seconds = 0.0
        for number in range(animation.n_frames):
            animation.seek(number)
            animation.load()
            seconds += animation.info["duration"] / 1000
        return (*animation.size, animation.n_frames, pytest.approx(seconds))


def test_a_film_alone_leaves_no_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["play", "lanes", "--arena", "s-bend", "--robots", "2", "--steps", "20"]
    assert main([*command, "--video", "run.webp", "--speed", "4", "--size", "200"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["run.webp"]
    assert "run.webp: 20 decisions, 6 s at speed 4, " in capsys.readouterr().out
    # 21 pictures, each a quarter of a decision's 0.3 s.
    assert film_size("run.webp") == (186, 84, 21, 21 * 0.3 / 4)


def test_a_saved_trajectory_is_filmed_and_recorded(tmp_path, played):
    recorded, filmed = tmp_path / "again.rrd", tmp_path / "again.gif"
    command = ["play", str(played / "run.npz"), "--steps", "10", "--save", str(recorded)]
    assert main([*command, "--video", str(filmed), "--size", "100"]) == 0
    assert film_size(filmed)[2:] == (11, 11 * 0.3)
    assert Reading(recorded).rows["/plots/delivered"]["step"].tolist() == [0, 10]


def test_without_a_name_no_recording_is_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert main(["play", "random", "--robots", "1", "--steps", "2"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"run.rrd", "run-2.rrd"}


def test_an_interrupted_film_is_kept_as_far_as_it_came(tmp_path):
    """In a process of its own that hears Ctrl-C."""
    film = ["--steps", "2900", "--speed", "16", "--size", "200", "--video", "run.webp"]
    process = subprocess.Popen(
        hearing_ctrl_c("play", "lanes", *film),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    # Each of them says that another tenth is filmed.
    begun = [process.stdout.readline() for _ in range(2)]
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert all(line.startswith("filming step ") for line in begun)
    assert (process.returncode, err) == (130, "robosim: interrupted\n")
    said = re.fullmatch(r"run\.webp: (\d+) decisions, \d+ s at speed 16, \d\.\d MB", out.splitlines()[-1])
    filmed = int(said[1])
    assert 0 < filmed < 2900
    # A picture for two decisions at this speed, and one of the start.
    with Image.open(tmp_path / "run.webp") as film:
        assert abs(film.n_frames - filmed / 2) <= 2
