import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import robosim
from robosim.cli.main import exit_code, main
from robosim.errors import InputError


def run_robosim(*arguments: str, encoding: str = "utf-8") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "robosim", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": encoding},
    )


def failing(failure: BaseException) -> Callable[[], None]:
    def action() -> None:
        raise failure

    return action


def test_version() -> None:
    result = run_robosim("--version")
    assert (result.returncode, result.stdout, result.stderr) == (0, f"robosim {robosim.__version__}\n", "")


def test_help_names_every_subcommand() -> None:
    result = run_robosim("--help")
    assert result.returncode == 0
    for name in ("demo", "arena", "train", "evaluate", "play", "policy", "technique", "profile", "bench"):
        assert name in result.stdout


@pytest.mark.parametrize(
    ("arguments", "same"),
    [([], ["--help"]), (["help"], ["--help"]), (["help", "arena"], ["arena", "--help"])],
)
def test_help_is_a_command_too_and_what_there_is_without_any(
    arguments: list[str], same: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    texts = []
    for given in (arguments, same):
        with pytest.raises(SystemExit) as ending:
            main(given)
        assert ending.value.code == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] != ""


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("evalute", "there is no command 'evalute': did you mean evaluate?"),
        ("fly\033[31m" + "y" * 500, f"there is no command 'fly?[31m{'y' * 68} ...': known names are arena,"),
    ],
)
@pytest.mark.parametrize("asked", [[], ["help"]])
def test_a_command_that_there_is_not_is_offered_the_nearest(
    name: str, sentence: str, asked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*asked, name]) == 2
    assert capsys.readouterr().err.startswith(f"robosim: {sentence}")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("arena", "arena needs one of list, show, check, random; see robosim arena --help."),
        ("arena fly", "Unrecognized options: fly; see robosim arena --help."),
        (
            "export",
            "export needs more: Trained policy by name, or policy or run folder; see robosim export --help.",
        ),
        ("sweep", "sweep needs more: The sweep (.toml); see robosim sweep --help."),
        ("--fly", "Unrecognized options: --fly; see robosim --help."),
    ],
)
def test_a_command_that_is_not_whole_says_what_it_needs_and_where_to_read(
    arguments: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments.split()) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"


def too_long(tmp_path: Path) -> str:
    return "a" * 300


def circle(tmp_path: Path) -> str:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    return "circle"


def pipe(tmp_path: Path) -> str:
    os.mkfifo(tmp_path / "pipe")
    return "pipe"


def no_text(tmp_path: Path) -> str:
    (tmp_path / os.fsdecode(b"\xff\x1b[31m")).write_text("[")
    return os.fsdecode(b"\xff\x1b[31m")


def digits(tmp_path: Path) -> str:
    return "9" * 5000


@pytest.mark.parametrize("what", [too_long, circle, pipe, no_text, digits])
@pytest.mark.parametrize(
    "arguments",
    [
        ["arena", "show", "NAME.toml"],
        ["policy", "show", "NAME"],
        ["play", "NAME.npz"],
        ["compare", "NAME"],
        ["sweep", "NAME"],
        ["train", "--resume", "NAME"],
        ["train", "--arena", "NAME", "--steps", "10", "--out", "run"],
        ["evaluate", "lanes", "--profile", "NAME"],
        ["evaluate", "lanes", "--json", "NAME/x.json"],
        ["evaluate", "lanes", "--report", "NAME/x"],
        ["evaluate", "lanes", "--seed", "NAME"],
        ["play", "lanes", "--save", "NAME/x.rrd"],
    ],
)
def test_strange_names_are_a_printable_line_and_exit_2(
    arguments: list[str],
    what: Callable[[Path], str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name = what(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main([argument.replace("NAME", name) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("robosim: ")
    assert error.replace("\n", "").isprintable()
    assert len(error) < 1500


@pytest.mark.parametrize("arguments", [["fly"], ["arena", "list", "--wings", "2"], ["demo", "--wings"]])
def test_wrong_usage_exits_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("robosim: ")
    assert len(said.err.splitlines()) == 1


WRONG_USAGE = pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["train", "--robots", "0"], "env.robots is 0, but must be a whole number from 1 to 1000."),
        (["evaluate", "lanes", "--bobots", "2"], "Unrecognized options: --bobots, 2; did you mean --robots?"),
        (["train", "--seed", "x"], "Error parsing --seed: invalid literal for int() with base 10: 'x'; see"),
        (["sweep", "a", "--workers", "x"], '--workers is "x", but must be a whole number; see robosim sweep'),
    ],
)


@WRONG_USAGE
def test_wrong_usage_is_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith(f"robosim: {sentence}")


@WRONG_USAGE
def test_so_it_is_where_the_output_takes_only_ascii(arguments: list[str], sentence: str) -> None:
    assert run_robosim(*arguments, encoding="ascii").stderr.startswith(f"robosim: {sentence}")


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [
        ("arena show no.toml", "arena file"),
        ("profile show no.toml", "profile"),
        ("evaluate lanes --arena no.toml", "arena file"),
        ("evaluate lanes --profile no.toml", "profile"),
        ("play no.npz", "trajectory"),
        ("view no.rrd", "recording"),
        ("sweep no.toml", "sweep file"),
        ("compare no.jsonl", "run folder, results file or evaluation"),
        ("leaderboard --records no.jsonl", "run folder, results file or evaluation"),
    ],
)
def test_a_file_that_is_not_there_is_named_by_its_kind(
    arguments: str,
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    name = arguments.split()[-1]
    assert main(arguments.split()) == 2
    assert capsys.readouterr().err == f"robosim: {name}: there is no such {kind}.\n"


def test_wrong_input_is_one_sentence_and_exit_2() -> None:
    result = run_robosim("arena", "show", "papr")
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("robosim: ")
    assert "papr" in result.stderr
    assert result.stderr.count("\n") == 1


def test_several_wrong_inputs_are_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(failing(InputError("One.\nTwo.")), debug=False) == 2
    assert capsys.readouterr().err == "robosim: One.\nrobosim: Two.\n"


def test_interrupt_is_130(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(failing(KeyboardInterrupt()), debug=False) == 130
    assert capsys.readouterr().err == "robosim: interrupted\n"


@pytest.mark.parametrize(
    ("failure", "line"),
    [
        (RuntimeError("out of\ntunnel"), "RuntimeError: out of tunnel"),
        (FileNotFoundError(2, "No such file or directory", "a.rrd"), "a.rrd: No such file or directory"),
    ],
)
def test_other_failures_are_one_line_and_exit_1(
    failure: Exception, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(failing(failure), debug=False) == 1
    assert capsys.readouterr().err == f"robosim: failed: {line} (add --debug for the traceback)\n"


@pytest.mark.parametrize("failure", [RuntimeError("tunnel"), InputError("tunnel")])
def test_debug_lets_a_failure_through(failure: Exception) -> None:
    with pytest.raises(type(failure), match="tunnel"):
        exit_code(failing(failure), debug=True)


def test_debug_as_an_option_or_in_the_environment_shows_the_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "Traceback" in run_robosim("arena", "show", "papr", "--debug").stderr
    monkeypatch.setenv("ROBOSIM_DEBUG", "1")
    assert "Traceback" in run_robosim("arena", "show", "papr").stderr


def test_a_reader_that_leaves_early_causes_no_noise() -> None:
    shell = f"set -o pipefail; {sys.executable} -m robosim arena list | true"
    result = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, timeout=60, check=False)
    assert result.stderr == ""
