"""robosim alone, in an environment of its own, simulates, evaluates, and says what else to install."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from robosim.cli.extras import EXTRAS, missing_extra

pytestmark = pytest.mark.slow
"""An environment of its own is made; `.ci/run` runs them."""

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> Path:
    """The folder of commands of an environment that holds robosim and what it cannot do without."""
    folder = tmp_path_factory.mktemp("alone")
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    commands = folder / "venv" / "bin"
    install = [commands / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, "--constraint", ROOT / "constraints.txt", ROOT], check=True)
    return commands


def run(alone: Path, folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [alone / command[0], *command[1:]],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_none_of_the_extras_is_there(alone: Path, tmp_path: Path) -> None:
    modules = [module for names in EXTRAS.values() for module in names] + ["pyarrow", "PIL"]
    code = f"import importlib.util as u; print(*(m for m in {modules!r} if u.find_spec(m)))"
    assert run(alone, tmp_path, "python", "-c", code).stdout.split() == []


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_scripted_and_trained_teams_are_evaluated(alone: Path, tmp_path: Path, world: str) -> None:
    for team in ("lanes", "paper-4"):
        command = ("evaluate", team, "--world", world, "--robots", "4", "--episodes", "1", "--steps", "200")
        result = run(alone, tmp_path, "robosim", *command)
        assert (result.returncode, result.stderr) == (0, "")
        assert "pellets" in result.stdout


def test_arenas_policies_and_the_faces_work(alone: Path, tmp_path: Path) -> None:
    for command in (
        ("arena", "list"),
        ("arena", "show", "paper"),
        ("policy", "list"),
        ("policy", "show", "paper-8"),
    ):
        assert run(alone, tmp_path, "robosim", *command).returncode == 0
    code = (
        "import gymnasium, robosim; env = gymnasium.make('robosim/Excavation-v0'); env.reset(); env.step(1); "
        "team = robosim.parallel_env('paper', robots=2); team.reset(seed=0); "
        "print(robosim.load_policy('paper-8').robots)"
    )
    assert run(alone, tmp_path, "python", "-c", code).stdout == "8\n"


@pytest.mark.parametrize(
    ("command", "module", "extra"),
    [
        (("train", "--steps", "1000", "--out", "run"), "torch", "train"),
        (("demo",), "torch", "train"),
        (("play", "lanes", "--save", "run.rrd"), "rerun", "view"),
        (("view", "run.rrd"), "rerun", "view"),
        (("play", "lanes", "--video", "run.mp4"), "av", "video"),
        (("play", "lanes", "--steps", "9", "--video", "run.gif"), "PIL", "video"),
        (("evaluate", "lanes", "--report", "out"), "matplotlib", "report"),
        (("arena", "show", "paper", "--png", "paper.png"), "matplotlib", "report"),
        (("export", "paper-2", "--onnx", "team.onnx"), "onnx", "deploy"),
    ],
)
def test_a_command_whose_extra_is_missing_says_which_before_it_does_anything(
    alone: Path, tmp_path: Path, command: tuple[str, ...], module: str, extra: str
) -> None:
    result = run(alone, tmp_path, "robosim", *command)
    assert result.returncode == 2
    assert result.stderr.startswith("robosim: this needs ")
    assert f"install robosim with its extra `{extra}`" in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_bench_leaves_the_learner_out_and_says_so(alone: Path, tmp_path: Path) -> None:
    code = "from robosim.cli.bench import measure_learner; print(measure_learner(1))"
    result = run(alone, tmp_path, "python", "-c", code)
    assert result.stdout == "learner: not measured, since torch is not installed (extra `train`)\nNone\n"
    assert result.stderr == ""


def test_all_is_every_extra_but_the_cluster_and_each_brings_what_is_said_of_it() -> None:
    extras = PROJECT["optional-dependencies"]
    names = {
        extra: {requirement.split(">")[0].split("~")[0] for requirement in extras[extra]} for extra in extras
    }
    # Ray is large, and one machine does without it.
    assert names["all"] == {f"robosim-swarm[{','.join(extra for extra in EXTRAS if extra != 'cluster')}]"}
    packages = {
        "tomli_w": "tomli-w",
        "rerun": "rerun-sdk",
        "rerun_cli": "rerun-sdk",
        "zenoh": "eclipse-zenoh",
    }
    for extra, modules in EXTRAS.items():
        assert {packages.get(module, module) for module in modules} <= names[extra]
    assert "pyarrow" in names["train"] & names["report"]
    assert "pillow" in names["video"] & names["report"]


def test_a_missing_module_of_no_extra_is_a_failure_like_any_other() -> None:
    assert missing_extra("numpy.linalg") is None
    assert missing_extra("matplotlib.figure") == (
        "this needs matplotlib, which is not installed: install robosim with its extra `report`, "
        "in a checkout by: pip install '.[report]'."
    )
