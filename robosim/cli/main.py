"""The command `robosim`: finds the subcommand, runs it, and turns failures into exit codes.

Exit codes: 0 done, 2 wrong input (a sentence on stderr, no traceback), 130 interrupted, 1 anything else.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Union

import tyro

import robosim
from robosim.cli.arena import Arena
from robosim.cli.bench import Bench
from robosim.cli.compare import Compare
from robosim.cli.demo import Demo
from robosim.cli.deploy import Deploy
from robosim.cli.evaluate import Evaluate
from robosim.cli.export import Export
from robosim.cli.extras import missing_extra
from robosim.cli.leaderboard import Leaderboard
from robosim.cli.play import Play
from robosim.cli.policy import Policy
from robosim.cli.profile import Profile
from robosim.cli.sweep import Sweep
from robosim.cli.technique import Technique
from robosim.cli.train import Train, train_command
from robosim.cli.view import View
from robosim.errors import IncompleteError, InputError, nearest_names, printable, shown
from robosim.plugins import load_plugins

DESCRIPTION = """Robot teams in confined spaces: simulate, train, evaluate, play back.

`--version` prints the version. `--debug` anywhere, or ROBOSIM_DEBUG=1, shows the traceback of a failure."""

_NO_FILE = {errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EILSEQ}
"""Of errors, what no path can be: where a path is only looked at, nobody else says it."""

Subcommand = (
    Demo
    | Arena
    | Train
    | Evaluate
    | Sweep
    | Compare
    | Leaderboard
    | Play
    | View
    | Policy
    | Technique
    | Profile
    | Export
    | Deploy
    | Bench
)
"""A parsed command line, ready to run."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (the process's own when None) and return its exit code.

    `--help` ends in SystemExit(0), raised by tyro.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names may hold bytes that are no text.
            stream.reconfigure(errors="backslashreplace")
    debug = "--debug" in arguments or os.environ.get("ROBOSIM_DEBUG", "0") not in {"", "0"}
    arguments = [argument for argument in arguments if argument != "--debug"]
    if arguments[:1] == ["--version"]:
        return exit_code(_print_version, debug)

    def run() -> None:
        load_plugins()
        parse(arguments).run()

    return exit_code(run, debug)


def exit_code(action: Callable[[], None], debug: bool) -> int:
    """Run `action` and return its exit code, with what went wrong in a line on stderr.

    With `debug`, failures and wrong input are raised instead, so that Python prints the traceback.
    """
    try:
        action()
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read our output has gone; Python's last flush at exit must not complain about it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        _complain("interrupted")
        return 130
    except InputError as error:
        if debug:
            raise
        for sentence in str(error).splitlines():
            _complain(sentence)
        return 2
    except IncompleteError as error:
        _complain(str(error))
        return 1
    except Exception as error:
        if debug:
            raise
        if isinstance(error, OSError) and error.errno in _NO_FILE:
            _complain(_one_line(error))
            return 2
        extra = missing_extra(error.name or "") if isinstance(error, ModuleNotFoundError) else None
        if extra is not None:
            _complain(extra)
            return 2
        _complain(f"failed: {_one_line(error)} (add --debug for the traceback)")
        return 1
    return 0


def parse(arguments: Sequence[str]) -> Subcommand:
    """Parse a command line without running it; InputError for wrong usage, SystemExit(0) after help."""
    arguments = _asked_for(arguments)
    complaint = io.StringIO()
    # Which options `train` has depends on its technique; they are looked up only where they are asked for.
    training = arguments[:1] == ["train"]
    train = train_command(arguments[1:]) if training else Train
    # A technique may switch anything on or off, so `train` has --OPTION and --no-OPTION both.
    flags = () if training else (tyro.conf.FlagCreatePairsOff,)
    try:
        with contextlib.redirect_stderr(complaint):
            parsed: Subcommand = tyro.cli(
                _subcommands(train),
                prog="robosim",
                description=DESCRIPTION,
                args=list(arguments) or ["--help"],
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, *flags),
            )
    except SystemExit as ending:
        if not ending.code:
            raise
        raise InputError(usage_sentence(complaint.getvalue(), arguments)) from None
    return parsed


def _asked_for(arguments: Sequence[str]) -> Sequence[str]:
    """Return what `help` asks for in the words of options; InputError for a command that there is not."""
    asked = [*arguments[1:], "--help"] if arguments[:1] == ["help"] else arguments
    first = asked[0] if asked else ""
    if first and not first.startswith("-") and first not in _commands(Train):
        near = nearest_names(first, _commands(Train))
        raise InputError(f"there is no command '{printable(first)}': {near}")
    return asked


def _subcommands(train: type[Train]) -> Any:
    named = _commands(train)
    return Union[tuple(Annotated[command, tyro.conf.subcommand(name)] for name, command in named.items())]  # noqa: UP007


def _commands(train: type[Train]) -> dict[str, Any]:
    return {
        "demo": Demo,
        "arena": Arena,
        "train": train,
        "evaluate": Evaluate,
        "sweep": Sweep,
        "compare": Compare,
        "leaderboard": Leaderboard,
        "play": Play,
        "view": View,
        "policy": Policy,
        "technique": Technique,
        "profile": Profile,
        "export": Export,
        "deploy": Deploy,
        "bench": Bench,
    }


def usage_sentence(box: str, arguments: Sequence[str]) -> str:
    """Return in one sentence what tyro says of wrong usage of `arguments`, in a box of several lines."""
    lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()]
    # Where the output takes only ASCII, the box has no sides, and one rule more: below its title.
    parts = " ".join("\n" if set(line) <= {"─", "-"} else line for line in lines[1:]).split("\n")
    sentence = " ".join(next((part for part in parts if part.strip()), "").split())
    # What a dataclass refuses is already a sentence, behind a name that means nothing to users.
    sentence = re.sub(r"^Error parsing __\S+: ", "", sentence)
    command = " ".join(["robosim", *(one for one in arguments[:1] if one in _commands(Train))])
    if choices := re.match(r"Expected one of \{(.+)\}\.$", sentence):
        return f"{command.removeprefix('robosim ')} needs one of {choices[1]}; see {command} --help."
    if missing := re.match(r"Missing from (robosim[\w ]+): (?:[A-Z]+ )?(.+?)\.? \(required\)", sentence):
        return f"{missing[1].removeprefix('robosim ')} needs more: {missing[2]}; see {missing[1]} --help."
    number = r"Error parsing (--[\w-]+): no type matching \{None\}\|(INT|FLOAT) could be .+ from \['(.*)'\]"
    if wrong := re.match(number, sentence):
        allowed = "a whole number" if wrong[2] == "INT" else "a number"
        return f"{wrong[1]} is {shown(wrong[3])}, but must be {allowed}; see {command} --help."
    meant = re.search(r"Perhaps you meant:\s+(--[\w-]+)", box.replace("│", ""))
    if meant:
        sentence += f"; did you mean {meant.group(1)}?"
    return sentence if sentence.endswith((".", "?")) else f"{sentence}; see {command} --help."


def _print_version() -> None:
    print(f"robosim {robosim.__version__}")


def _complain(sentence: str) -> None:
    print(f"robosim: {printable(sentence, 1000)}", file=sys.stderr)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
