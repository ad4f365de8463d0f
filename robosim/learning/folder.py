"""The folder of a run: what lies where in it, written whole, and removed only if a run wrote it.

A run is begun once `config.toml` is there, and finished once `finished.json` is, which is written last. In
between, whatever else is there, it can be resumed.
"""

from __future__ import annotations

import contextlib
import json
import re
import stat
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from robosim.control.card import MOST, MOST_BYTES, Count, Evaluation, read_evaluation
from robosim.control.policy import (
    CARD_FILE,
    RUN_CONFIG,
    RUN_POLICY,
    RUN_RECORD,
    WEIGHTS_FILE,
    Policy,
    save_policy,
)
from robosim.envs.config import MOST_CONFIG
from robosim.errors import InputError, printable, shown
from robosim.files import (
    digests,
    is_regular,
    remove_strays,
    require_unchanged,
    sync,
    whole_file,
    write_whole,
)
from robosim.learning.checkpoint import is_checkpoint_file, remove_checkpoints
from robosim.learning.config import RunConfig, read_config, write_config
from robosim.texts import parse_json, read_limited, read_text, read_toml

CONFIG_FILE = RUN_CONFIG
METRICS_FILE = "metrics.parquet"
EVALUATION_FILE = "evaluation.json"
COMMAND_FILE = "command.txt"
FINISHED_FILE = RUN_RECORD
CHECKPOINTS = "checkpoints"
RECORDINGS = "recordings"
CURVES = "tensorboard"
START = "start"
"""The policy that the run started from, if any: a copy."""

_LONGEST_COMMAND = 2000
"""Bytes of the command that began a run; a card takes no longer one."""
_FILES = (CONFIG_FILE, COMMAND_FILE, METRICS_FILE, EVALUATION_FILE, FINISHED_FILE)
_FOLDERS = (CHECKPOINTS, RECORDINGS, CURVES, RUN_POLICY, START)
_RECORDING = re.compile(r"(live-)?\d{12}\.rrd")
_POLICY_SCRATCH = re.compile(rf"\.({RUN_POLICY}|{START})-[a-z0-9_]{{8}}")
"""Where `save_policy` writes a policy before it takes its place."""


@dataclass(frozen=True, slots=True)
class Finished:
    """The last record of a run."""

    steps: Count
    """Joint decisions."""
    wall_time: Annotated[float, Field(ge=0, le=MOST)]
    """Time spent learning, all parts of an interrupted run together, s."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the other files of the run, by their paths in its folder."""


_FINISHED = TypeAdapter(Finished)


class RunFolder:
    """A run's folder, by the names in it; nothing in it is read, written or removed through a link."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.checkpoints = path / CHECKPOINTS
        self.recordings = path / RECORDINGS
        self.curves = path / CURVES
        self.policy = path / RUN_POLICY
        self.start = path / START
        self.metrics = path / METRICS_FILE

    @property
    def begun(self) -> bool:
        """Whether there is a run in it."""
        return (self.path / CONFIG_FILE).exists()

    def make(self) -> None:
        """Make the folder, if it is not there; InputError where none can be made."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise InputError(f"{self.path}: this is a file; a run needs a folder.") from None
        except OSError as error:
            raise self._unwritable(error) from None

    def require_begun(self) -> None:
        """Raise InputError if there is no run in it."""
        if not self.begun:
            raise InputError(f"{self.path}: no run to resume: there is no {CONFIG_FILE} in it.")

    def begin(self, config: RunConfig, command: str, start: Policy | None = None) -> None:
        """Make the folder, if need be, and write what the run depends on, with the policy it starts from.

        InputError if something is in it, or it cannot be written.
        """
        self.make()
        try:
            self._remove_strays()
            if not all(map(self._is_of_a_beginning, self.path.iterdir())):
                held = "is not empty"
                if self.begun:
                    finished = (self.path / FINISHED_FILE).exists()
                    held = "holds a finished run" if finished else "holds a run; `--resume` goes on with it"
                raise InputError(f"{self.path}: this folder {held}; a new run needs a new one.")
        except OSError as error:
            raise self._unwritable(error) from None
        if command:
            write_whole(self.path / COMMAND_FILE, command + "\n")
        if start is not None:
            network = start.card.network.changed(precision="float32")
            save_policy(self.start, start.weights(), start.card.changed(network=network))
        with whole_file(self.path / CONFIG_FILE, durable=True) as part:
            write_config(config, part)

    def reopen(self) -> RunConfig:
        """Return the configuration of the run that is to go on, once the folder is in order.

        What a killed process left is removed. InputError if there is no run, or a finished one, if the
        configuration is not whole, or if something else lies where a run writes.
        """
        self.require_begun()
        self._check_layout()
        try:
            self._remove_strays()
            if self.finished() is not None:
                remove_checkpoints(self.checkpoints)
                raise InputError(
                    f"{self.path}: this run is finished; there is nothing to resume, but a new run can go on "
                    "from its policy with --start-from."
                )
        except OSError as error:
            raise self._unwritable(error) from None
        return self.config()

    def config(self) -> RunConfig:
        """Return the run's configuration; InputError if it is not the whole of one."""
        path = self.path / CONFIG_FILE
        config = read_config(path)
        with tempfile.TemporaryDirectory() as scratch:
            write_config(config, Path(scratch) / CONFIG_FILE)
            whole = _table(Path(scratch) / CONFIG_FILE)
        if missing := _missing(_table(path), whole):
            raise InputError(
                f"{path}: {missing} is missing, but must be there: a run's configuration is whole."
            )
        return config

    def require_config(self, config: RunConfig) -> None:
        """Raise InputError, with the first field that differs, if the run has another configuration."""
        held, asked = (one.model_dump(mode="json") for one in (self.config(), config))
        if (name := _first_difference(held, asked)) is None:
            return
        values = [shown(_at(table, name)) for table in (held, asked)]
        # Of two texts of arenas no more than the beginning is shown.
        what = f"{values[0]} in the run that this folder holds, not {values[1]}"
        what = what if values[0] != values[1] else "another in the run that this folder holds"
        raise InputError(
            f"{self.path}: {'.'.join(name)} is {what}; a run of its own needs a folder of its own."
        )

    def command(self) -> str:
        """Return the command that began the run; empty where it is not known."""
        try:
            text = read_text(self.path / COMMAND_FILE, _LONGEST_COMMAND, "command").strip()
        except InputError:
            return ""
        return text if text.isprintable() else ""

    def evaluation(self) -> Evaluation | None:
        """Return the evaluation of the finished team, if any."""
        path = self.path / EVALUATION_FILE
        return read_evaluation(path) if path.exists() else None

    def write_evaluation(self, evaluation: Evaluation) -> None:
        write_whole(self.path / EVALUATION_FILE, evaluation.model_dump_json(indent=2) + "\n")

    def finished(self) -> Finished | None:
        """Return the last record of a finished run, None of any other.

        InputError if it is damaged, or a file is no longer what the run wrote.
        """
        path = self.path / FINISHED_FILE
        try:
            if not path.exists():
                return None
            finished = _FINISHED.validate_python(
                parse_json(read_limited(path, MOST_BYTES, "record of a run"))
            )
        except InputError:
            raise
        except (OSError, ValueError) as error:
            reason = printable(str(error), 200)
            raise InputError(f"{path}: not the last record of a run ({reason}).") from None
        require_unchanged(self.path, finished.files)
        return finished

    def finish(self, steps: int, wall_time: float) -> None:
        """Write the last record, once all else is on the disk, and remove what only a resume needs."""
        try:
            for path in (self.path, self.policy):
                for written in path.iterdir():
                    if is_regular(written):
                        sync(written)
                sync(path)
        except OSError as error:
            raise self._unwritable(error) from None
        policies = [f"{one}/{name}" for one in (RUN_POLICY, START) for name in (CARD_FILE, WEIGHTS_FILE)]
        kept = (*_FILES, *policies)
        record = Finished(steps, wall_time, digests(self.path, kept))
        write_whole(self.path / FINISHED_FILE, json.dumps(asdict(record)) + "\n", durable=True)
        # Not before: until here a kill must find something to go on from.
        remove_checkpoints(self.checkpoints)

    def recording(self, step: int) -> Path:
        """Return where the playback of decision `step` is recorded."""
        self.recordings.mkdir(exist_ok=True)
        return self.recordings / f"{step:012d}.rrd"

    def _is_of_a_beginning(self, path: Path) -> bool:
        """Return whether a run that was killed as it began has left that: its command, its first policy."""
        if path.name == START:
            return not self.begun and path.is_dir() and not path.is_symlink() and not _strange_in(path)
        is_command = path.name == COMMAND_FILE and is_regular(path)
        return is_command and (self.command() + " ").startswith("robosim ")

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"{self.path}: the run folder cannot be written: {error.strerror or error}.")

    def _check_layout(self) -> None:
        """Raise InputError if something else lies where a run writes."""
        for names, kind, is_kind in (
            (_FILES, "regular file", stat.S_ISREG),
            (_FOLDERS, "folder", stat.S_ISDIR),
        ):
            for name in names:
                with contextlib.suppress(FileNotFoundError):
                    mode = (self.path / name).lstat().st_mode
                    if not is_kind(mode):
                        found = "a link" if stat.S_ISLNK(mode) else "something else"
                        raise InputError(
                            f"{self.path / name}: this is {found}, but must be a {kind}: a run writes there."
                        )
        if strange := _strange_in(self.policy):
            raise InputError(
                f"{self.policy}: holds {shown(min(strange))}, but must hold a policy alone: it is replaced."
            )

    def _remove_strays(self) -> None:
        """Remove what killed processes have left half written."""
        remove_strays(self.path, lambda name: name in _FILES)
        for folder, written in (
            (self.checkpoints, is_checkpoint_file),
            (self.recordings, lambda name: bool(_RECORDING.fullmatch(name))),
        ):
            if folder.is_dir() and not folder.is_symlink():
                remove_strays(folder, written)
        for path in self.path.iterdir():
            if _POLICY_SCRATCH.fullmatch(path.name) and not path.is_symlink() and path.is_dir():
                _remove_scratch(path)


def _strange_in(policy: Path) -> set[str]:
    """Return the names in a policy's folder, if there is one, that are not of its files."""
    names = {path.name for path in policy.iterdir()} if policy.is_dir() else set()
    return names - {WEIGHTS_FILE, CARD_FILE}


def _remove_scratch(scratch: Path) -> None:
    for policy in (scratch / "new", scratch / "old"):
        if policy.is_dir() and not policy.is_symlink():
            for name in (WEIGHTS_FILE, CARD_FILE):
                if is_regular(policy / name):
                    (policy / name).unlink()
            _remove_empty(policy)
    _remove_empty(scratch)


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _table(path: Path) -> dict[str, Any]:
    return read_toml(path, MOST_CONFIG, "run configuration")


def _missing(table: Mapping[str, Any], whole: Mapping[str, Any]) -> str:
    """Return the first key of `whole` that `table` lacks, with those above it; empty if none."""
    for name, value in whole.items():
        if name not in table:
            return name
        if isinstance(value, dict) and (below := _missing(table[name], value)):
            return f"{name}.{below}"
    return ""


def _first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the keys that lead to the first value in which two tables differ; None if they are equal."""
    for name in {**one, **other}:
        mine, theirs = one.get(name), other.get(name)
        if isinstance(mine, dict) and isinstance(theirs, dict):
            if (below := _first_difference(mine, theirs)) is not None:
                return name, *below
        elif mine != theirs:
            return (name,)
    return None


def _at(table: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    for key in keys:
        table = table.get(key)  # type: ignore[assignment]  # the last one is the value
    return table
