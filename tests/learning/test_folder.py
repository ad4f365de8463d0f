"""What a run's folder is at every moment, and whose files in it are touched."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from robosim.control.policy import load_policy
from robosim.errors import InputError
from robosim.files import write_whole
from robosim.learning.checkpoint import list_checkpoints
from robosim.learning.config import read_config, run_config
from robosim.learning.folder import RunFolder
from robosim.learning.trainer import finished_result, resume, train

TINY = run_config(
    arena="single-lane", technique="iql+s", steps=12, robots=1, num_envs=1, episode_steps=8, warmup=4,
    hidden=(8,), checkpoint_every=6, record_every=12, record_steps=1, evaluation_steps=2,
    evaluation_episodes=1,
)  # fmt: skip
RUN = {
    "command.txt", "config.toml", "metrics.parquet", "policy", "evaluation.json", "tensorboard", "recordings",
    "finished.json",
}  # fmt: skip


def ignore(row):
    pass


def record(controller, env, path):
    env.reset()
    write_whole(path, f"{controller.policy.robots}")


def begin(folder, config=TINY):
    return train(config, folder, ignore, "robosim train --some-flag", record)


def result(folder):
    """Return all that a run has learned and found out."""
    evaluation = finished_result(folder).evaluation
    weights = (folder / "policy" / "policy.safetensors").read_bytes()
    return weights, evaluation and evaluation.model_copy(update={"controller": ""})


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


WRITES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir"}


def killed_at(count, work):
    """Do `work` in a process that kills itself before the `count`-th change of the file system, from 0.

    Returns whether it was killed. A file is opened by one change and takes its name by another, so that it
    is also found half written.
    """
    child = os.fork()
    if child:
        status = os.waitpid(child, 0)[1]
        if os.WIFSIGNALED(status):
            assert os.WTERMSIG(status) == signal.SIGKILL
            return True
        assert status == 0
        return False
    left = count

    def watch(event, arguments):
        nonlocal left
        opened = (
            event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        )
        if (opened and arguments[0] != "/dev/null") or event in WRITES:
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left -= 1

    try:
        sys.addaudithook(watch)
        work()
        os._exit(0)
    except BaseException:
        import traceback

        traceback.print_exc()
        os._exit(1)


def go_on(folder):
    """Do what a person does who finds that the run was killed."""
    if (folder / "config.toml").exists():
        resume(folder, ignore, record, pytest.fail)
    else:
        begin(folder, go_on.config)


@pytest.mark.slow
@pytest.mark.parametrize("episodes", [0, 1])
def test_killed_at_any_change_of_its_folder_a_run_ends_in_the_same_bits(tmp_path, episodes):
    go_on.config = config = TINY.with_options(evaluation_episodes=episodes)
    whole = tmp_path / "whole"
    begin(whole, config)
    count, at = 0, tmp_path / "0"
    while killed_at(count, lambda at=at: begin(at, config)):
        finished = (at / "finished.json").exists()
        # Every third one is killed again as it goes on.
        if count % 3 == 0 and not finished and (at / "config.toml").exists():
            killed_at(count % 7, lambda at=at: go_on(at))
            finished = (at / "finished.json").exists()
        if finished:
            with pytest.raises(InputError, match="finished; there is nothing to resume, but a new run"):
                resume(at, ignore)
        else:
            go_on(at)
        assert result(at) == result(whole), count
        assert {path.name for path in at.iterdir()} == {path.name for path in whole.iterdir()}, count
        assert [path.name for path in (at / "recordings").iterdir()] == ["000000000012.rrd"]
        count += 1
        at = tmp_path / f"{count}"
    # It went through to the end without any kill: then all changes have been tried.
    assert result(at) == result(whole)
    assert count > 40


SLOW = TINY.with_options(steps=600, checkpoint_every=100, record_every=0, evaluation_steps=200)


@pytest.mark.slow
@pytest.mark.parametrize("sign", ["config.toml", "metrics.parquet", "policy/card.json", "finished.json"])
def test_a_process_killed_when_a_file_appears_is_resumed_to_the_same_bits(tmp_path, sign, slow_run):
    at = tmp_path / "run"
    program = (
        "import sys; from pathlib import Path; from robosim.learning.config import read_config;"
        "from robosim.learning.trainer import train;"
        "train(read_config(Path(sys.argv[1])), Path(sys.argv[2]), lambda row: None)"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(slow_run / "config.toml"), str(at)])
    deadline = time.monotonic() + 60.0
    while not list(at.glob(sign)):
        assert time.monotonic() < deadline
        assert process.poll() is None or list(at.glob(sign))
    process.kill()
    process.wait()
    if (at / "finished.json").exists():
        with pytest.raises(InputError, match="this run is finished"):
            resume(at, ignore)
    else:
        resume(at, ignore)
    assert result(at) == result(slow_run)
    assert {path.name for path in at.iterdir()} == {path.name for path in slow_run.iterdir()}


@pytest.fixture(scope="module")
def slow_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slow") / "run"
    train(SLOW, folder, ignore)
    return folder


def interrupted(folder):
    """Leave a run with a checkpoint behind, in the middle."""

    def stop(controller, env, path):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(TINY.with_options(record_every=6), folder, ignore, record=stop)
    assert [path.name for path in list_checkpoints(folder / "checkpoints")] == ["000000000006.safetensors"]


@pytest.fixture
def strangers(tmp_path):
    """A folder of the user's own, with names like those of a run in it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("000000000012.safetensors", "notes.txt", "experience-0000-000000000000-000000000012.zst",
                 "policy.safetensors", "card.json", "000000000012.rrd", ".card.json.5.part"):  # fmt: skip
        (folder / name).write_text("mine")
    return folder


def untouched(strangers):
    return len(everything(strangers)) == 7 and all(path.read_text() == "mine" for path in strangers.iterdir())


@pytest.mark.parametrize("name", ["checkpoints", "recordings", "tensorboard", "policy"])
@pytest.mark.parametrize("state", ["under way", "finished"])
def test_nothing_is_done_through_a_link(tmp_path, strangers, name, state):
    at = tmp_path / "run"
    if state == "finished":
        begin(at)
    else:
        interrupted(at)
    if (at / name).exists():
        (at / name).rename(tmp_path / "away")
    (at / name).symlink_to(strangers)
    before = everything(at)
    with pytest.raises(InputError) as caught:
        resume(at, ignore)
    assert str(caught.value) == f"{at / name}: this is a link, but must be a folder: a run writes there."
    assert untouched(strangers)
    assert everything(at) == before


@pytest.mark.parametrize("name", ["checkpoints", "recordings", "tensorboard", "policy"])
def test_a_file_where_a_run_has_a_folder_is_a_sentence(tmp_path, name):
    at = tmp_path / "run"
    interrupted(at)
    if (at / name).exists():
        (at / name).rename(tmp_path / "away")
    (at / name).write_text("mine")
    with pytest.raises(InputError) as caught:
        resume(at, ignore)
    assert (
        str(caught.value) == f"{at / name}: this is something else, but must be a folder: a run writes there."
    )
    assert (at / name).read_text() == "mine"


@pytest.mark.parametrize(
    "name", ["config.toml", "command.txt", "metrics.parquet", "evaluation.json", "finished.json"]
)
def test_a_link_where_a_run_writes_a_file_is_a_sentence(tmp_path, name):
    at, mine = tmp_path / "run", tmp_path / "mine.txt"
    interrupted(at)
    mine.write_text("")
    if (at / name).exists():
        (at / name).rename(mine)
    (at / name).symlink_to(mine)
    before = mine.read_bytes()
    with pytest.raises(InputError) as caught:
        resume(at, ignore)
    assert (
        str(caught.value) == f"{at / name}: this is a link, but must be a regular file: a run writes there."
    )
    assert mine.read_bytes() == before


def test_what_others_put_into_a_run_stays(tmp_path):
    at, mine = tmp_path / "run", tmp_path / "mine"
    interrupted(at)
    mine.write_text("mine")
    for folder in (at, at / "checkpoints", at / "tensorboard"):
        (folder / "notes.txt").write_text("mine")
        (folder / "folder").mkdir()
        (folder / ".config.toml.5.part").symlink_to(mine)
        (folder / ".metrics.parquet.part").write_text("mine")
    (at / "checkpoints" / "000000000001.safetensors").symlink_to(mine)
    (at / "checkpoints" / "experience-mine").write_text("mine")
    (at / ".policy-abcdefgh").mkdir()
    (at / ".policy-abcdefgh" / "notes.txt").write_text("mine")
    mine_too = ("folder", "notes.txt", "experience-mine", ".metrics.parquet.part")
    kept = [path for path in at.rglob("*") if path.is_symlink() or path.name in mine_too]
    resume(at, ignore)
    assert all(path.is_symlink() or path.exists() for path in kept)
    assert mine.read_text() == "mine"
    assert finished_result(at) is not None


def test_a_policy_with_something_beside_it_is_refused_before_the_run_goes_on(tmp_path):
    at = tmp_path / "run"
    interrupted(at)
    (at / "policy" / "notes.txt").write_text("mine")
    with pytest.raises(InputError) as caught:
        resume(at, pytest.fail)
    assert str(caught.value) == (
        f'{at / "policy"}: holds "notes.txt", but must hold a policy alone: it is replaced.'
    )


def test_what_killed_processes_left_half_written_is_removed(tmp_path):
    at = tmp_path / "run"
    interrupted(at)
    strays = [
        at / ".config.toml.5.part", at / ".config.toml.5.probe", at / ".metrics.parquet.77.part",
        at / ".finished.json.5.part", at / "checkpoints" / ".000000000500.safetensors.5.part",
        at / "checkpoints" / ".experience-0000-000000000000-000000000012.zst.5.part",
        at / "recordings" / ".000000000500.rrd.5-123456.part",
        at / ".policy-abc_e1gh" / "new" / "policy.safetensors", at / ".policy-abc_e1gh" / "old" / "card.json",
    ]  # fmt: skip
    for stray in strays:
        stray.parent.mkdir(parents=True, exist_ok=True)
        stray.write_text("half")
    resume(at, ignore)
    assert not [path for path in at.rglob("*") if path.name.startswith(".")]


@pytest.mark.parametrize("text", ["", "\n# nothing\n"])
def test_an_empty_configuration_is_a_sentence(tmp_path, text):
    at = tmp_path / "run"
    interrupted(at)
    (at / "config.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        resume(at, pytest.fail)
    assert re.fullmatch(
        rf"{re.escape(str(at))}/config.toml: \w+ is missing, but must be there: a run's configuration is "
        r"whole\.",
        str(caught.value),
    )


def test_a_configuration_cut_short_anywhere_is_a_sentence(tmp_path):
    at = tmp_path / "run"
    interrupted(at)
    whole = (at / "config.toml").read_text()
    for end in range(len(whole) - 1):
        (at / "config.toml").write_text(whole[:end])
        # The last value, cut short, can be another value.
        if end <= whole.rstrip().rindex("\n"):
            with pytest.raises(InputError, match=re.escape(f"{at}/config.toml: ")):
                RunFolder(at).reopen()
    (at / "config.toml").write_text(whole)
    assert RunFolder(at).reopen() == read_config(at / "config.toml")


def test_a_damaged_last_record_is_a_sentence(tmp_path):
    at = tmp_path / "run"
    begin(at)
    assert finished_result(at).wall_time > 0.0
    (at / "finished.json").write_text('{"steps": 12')
    with pytest.raises(InputError, match=r"finished.json: not the last record of a run \(.*\)\.$"):
        resume(at, ignore)


def test_a_run_that_is_not_there_or_under_way_has_no_result(tmp_path):
    assert finished_result(tmp_path / "nowhere") is None
    interrupted(tmp_path / "run")
    assert finished_result(tmp_path / "run") is None
    assert load_policy(tmp_path / "run").card.evaluation is None


def test_a_folder_in_use_or_out_of_reach_is_a_sentence(tmp_path):
    full, named = tmp_path / "full", tmp_path / "named"
    for folder, name in ((full, "notes.txt"), (named, "command.txt")):
        folder.mkdir()
        (folder / name).write_text("mine")
    begun = tmp_path / "begun"
    RunFolder(begun).begin(TINY, "robosim train")
    over = tmp_path / "over"
    RunFolder(over).begin(TINY, "robosim train")
    (over / "finished.json").write_text("{}")
    file = tmp_path / "file"
    file.write_text("")
    for folder, sentence in (
        (full, "this folder is not empty; a new run needs a new one."),
        (named, "this folder is not empty; a new run needs a new one."),
        (begun, "this folder holds a run; `--resume` goes on with it; a new run needs a new one."),
        (over, "this folder holds a finished run; a new run needs a new one."),
        (file, "this is a file; a run needs a folder."),
        (file / "run", "the run folder cannot be written: Not a directory."),
    ):
        with pytest.raises(InputError) as caught:
            RunFolder(folder).begin(TINY, "")
        assert str(caught.value) == f"{folder}: {sentence}"
    assert (full / "notes.txt").read_text() == (named / "command.txt").read_text() == "mine"


def test_a_run_is_one_process_at_a_time(tmp_path):
    """A second one would take the files that the first writes for what a killed process has left."""
    at, said = tmp_path / "run", []

    def meanwhile(row):
        for work in (lambda: resume(at, ignore), lambda: begin(at)):
            with pytest.raises(InputError) as caught:
                work()
            said.append(str(caught.value))

    begin_once = run_config("iql+s", steps=4, num_envs=1, warmup=2, hidden=(8,), evaluation_episodes=0)
    train(begin_once, at, meanwhile)
    assert said == [f"{at}: another process is at work in this folder."] * 2
    # Once it has ended, the folder says what it holds.
    with pytest.raises(InputError, match="this run is finished"):
        resume(at, ignore)


def test_a_run_that_was_killed_as_it_began_can_begin_again(tmp_path):
    at = tmp_path / "run"
    at.mkdir()
    (at / "command.txt").write_text("robosim train --out run\n")
    (at / ".config.toml.5.part").write_text("arena =")
    RunFolder(at).begin(TINY, "robosim train")
    assert everything(at) == ["command.txt", "config.toml"]
    assert RunFolder(at).command() == "robosim train"
    assert RunFolder(at).config() == TINY


def test_one_that_was_killed_between_its_first_policy_and_its_configuration_can_begin_again(tmp_path):
    at, policy = tmp_path / "run", load_policy("paper-2")
    RunFolder(at).begin(TINY, "robosim train", policy)
    (at / "config.toml").unlink()
    (at / ".start-abcd1234" / "new").mkdir(parents=True)
    RunFolder(at).begin(TINY, "robosim train", policy)
    assert everything(at) == [
        "command.txt", "config.toml", "start", "start/card.json", "start/policy.safetensors"
    ]  # fmt: skip
    kept = load_policy(at / "start")
    assert all(np.array_equal(array, kept.weights()[name]) for name, array in policy.weights().items())
    # Something of a stranger's in it is left alone.
    (at / "config.toml").unlink()
    (at / "start" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="this folder is not empty"):
        RunFolder(at).begin(TINY, "robosim train", policy)
    assert (at / "start" / "notes.txt").read_text() == "mine"
