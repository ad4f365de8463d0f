"""Run folders that somebody has changed: each is one sentence, soon, within the memory that its run needs."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from robosim.errors import InputError
from robosim.learning.checkpoint import (
    list_checkpoints,
    part_name,
    read_checkpoint,
    read_part,
    write_checkpoint,
    write_part,
)
from robosim.learning.config import run_config
from robosim.learning.folder import RunFolder
from robosim.learning.metrics import Metrics, read_metrics
from robosim.learning.trainer import finished_result, resume, train

MOST = 10**8
"""Bytes, more than any checkpoint here takes."""
CONFIG = run_config(
    "iql+s", robots=2, arena="single-lane", world="grid", steps=700, num_envs=2, episode_steps=60, warmup=40,
    hidden=(8, 8), evaluation_episodes=0,
)  # fmt: skip
Facts = dict[str, Any]


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was interrupted, with one checkpoint."""
    folder = tmp_path_factory.mktemp("begun") / "run"

    def stop(row: Metrics) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, folder, stop)
    (checkpoint,) = list_checkpoints(folder / "checkpoints")
    assert checkpoint.stem == f"{500:012d}"
    return folder


@pytest.fixture
def folder(begun: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(begun, tmp_path / "run"))


def refusal(call: Callable[..., Any], *args: Any) -> str:
    began = time.process_time()
    with pytest.raises(InputError) as refused:
        call(*args)
    sentence = str(refused.value)
    assert time.process_time() - began < 5.0
    assert sentence.isprintable()
    assert len(sentence) < 700
    return sentence


def resumed(folder: Path) -> None:
    resume(folder, lambda row: None)


def test_the_run_that_the_others_are_made_of_goes_on(folder: Path) -> None:
    resumed(folder)
    assert finished_result(folder).steps == 700  # type: ignore[union-attr]


def wall_time(value: object) -> Callable[[Facts], None]:
    return lambda facts: facts.update(wall_time=value)


def rows(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts["rows"][0].update(changes)


def sums(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts["sums"].update(changes)


def loop(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts["loop"].update(changes)


def algorithm(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts["loop"]["algorithm"].update(changes)


def learner(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts["loop"]["algorithm"]["learner"].update(changes)


def fields(**changes: object) -> Callable[[Facts], None]:
    return lambda facts: facts.update(changes)


def memory(*parts: list[object]) -> Callable[[Facts], None]:
    return lambda facts: facts.update(memory=list(parts))


STAGE = {"name": "together", "robots": 2, "learning": 2, "steps": 1, "ended": "budget"}


@pytest.mark.parametrize(
    "change",
    [
        wall_time("x"), wall_time(float("inf")), wall_time(float("nan")), wall_time(-1.0), wall_time(10**40),
        rows(step="x"), rows(step=10**40), rows(step=-1), rows(figures=[1]), rows(figures={"loss": "x"}),
        rows(stage=5), sums(step=10**40), sums(reward="x"), sums(figures=None),
        loop(step="x"), loop(step=10**30), loop(step=-1), loop(step=None), loop(algorithm=5),
        algorithm(decisions=10**15), algorithm(decisions=-1), algorithm(decisions="x"),
        algorithm(learner=None),
        learner(updates=-(10**20)), learner(updates="x"), learner(explore={}), learner(draw=[1]),
        fields(seeds="x"), fields(seeds=[1]), fields(seeds=[-1, -2]), fields(seeds=[10**40, 1]),
        fields(episode="x"), fields(episode=-1), fields(episode=None), fields(config="other"),
        fields(ended=[STAGE] * 5), fields(ended=5), fields(ended=[{"name": "\x1b[31m"}]), fields(rows="x"),
        fields(team={"inputs": 10**9}), fields(loop=[]), fields(sums=[]),
        memory([0, 10**12, "../../x"]), memory([5, 3, part_name(0, 5, 3)]), memory(["x", None, "y"]),
        memory([0, 9, part_name(0, 0, 9)], [0, 9, part_name(0, 0, 9)]),
        memory([0, 9, part_name(0, 0, 9)]), memory([-9, 0, part_name(0, -9, 0)]),
    ],
)  # fmt: skip
def test_facts_that_no_run_has_are_one_sentence(folder: Path, change: Callable[[Facts], None]) -> None:
    (path,) = list_checkpoints(folder / "checkpoints")
    kept = read_checkpoint(path, MOST)
    facts = json.loads(json.dumps(kept.facts))
    change(facts)
    write_checkpoint(path.parent, replace(kept, facts=facts))
    refusal(resumed, folder)


def test_more_actions_than_decisions_are_not_run_again(folder: Path) -> None:
    (path,) = list_checkpoints(folder / "checkpoints")
    kept = read_checkpoint(path, MOST)
    tensors = {**kept.tensors, "actions": torch.zeros((5_000_000, 2, 2), dtype=torch.uint8)}
    write_checkpoint(path.parent, replace(kept, tensors=tensors))
    assert refusal(resumed, folder) == (
        "the checkpoint is not one of this run (ValueError: it holds more actions than decisions)."
    )


def test_a_checkpoint_larger_than_its_run_is_not_read(folder: Path) -> None:
    (path,) = list_checkpoints(folder / "checkpoints")
    sentence = refusal(read_checkpoint, path, 1000)
    assert sentence == f"{path}: larger than 1000 bytes, the most that a checkpoint may have."
    with path.open("r+b") as file:
        file.truncate(2**37)
    refusal(resumed, folder)


def test_a_part_that_unpacks_to_more_than_its_run_holds_is_not_unpacked(tmp_path: Path) -> None:
    name = part_name(0, 0, 9)
    write_part(tmp_path, name, {"rewards": torch.zeros(1000)})
    assert read_part(tmp_path, name, 4000)["rewards"].shape == (1000,)
    (tmp_path / name).write_bytes(pa.compress(bytes(2**28), codec="zstd", asbytes=True))
    sentence = refusal(read_part, tmp_path, name, 4000)
    assert sentence.startswith(
        f"{tmp_path / name}: not a whole part of a checkpoint (unpacked, it takes more"
    )


def replaced(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / name
        path.unlink(missing_ok=True)
        make(path)

    return change


def long_text(path: Path) -> None:
    path.write_text("robosim train " + "x" * 3000)


@pytest.mark.parametrize(
    "make", [Path.mkdir, os.mkfifo, long_text, lambda path: path.write_bytes(b"\xff"), lambda path: None]
)
def test_a_command_that_is_none_is_left_out(folder: Path, make: Callable[[Path], object]) -> None:
    replaced("command.txt", make)(folder)
    assert RunFolder(folder).command() == ""


@pytest.mark.parametrize(
    "text",
    [
        "5", "[]", "{}", '{"steps": 1}', '{"steps": "x", "wall_time": 1.0}', '{"steps": 1, "wall_time": NaN}',
        '{"steps": 1e400, "wall_time": 1.0}', '{"steps": ' + "9" * 5000 + ', "wall_time": 1.0}',
        '{"steps": 1, "wall_time": 1.0, "files": 5}', '{"steps": 1, "wall_time": 1.0, "files": {"a": 5}}',
        '{"steps": 1, "wall_time": 1.0, "files": {"../../etc/passwd": "x"}}', "[" * 100_000, "\x1b[31m",
    ],
)  # fmt: skip
def test_a_last_record_that_is_none_is_one_sentence(folder: Path, text: str) -> None:
    (folder / "finished.json").write_text(text)
    refusal(finished_result, folder)


@pytest.mark.parametrize("name", ["finished.json", "config.toml"])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(folder: Path, name: str) -> None:
    replaced(name, os.mkfifo)(folder)
    assert "regular file" in refusal(resumed, folder)


def test_metrics_that_unpack_to_more_than_a_run_has_are_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "metrics.parquet"
    pq.write_table(pa.table({"step": pa.nulls(40_000_000)}), path)
    assert path.stat().st_size < 10_000_000
    assert refusal(read_metrics, path).endswith("too large for the metrics of a run.")
