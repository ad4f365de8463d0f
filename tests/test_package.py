import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import robosim

ROOT = Path(__file__).parent.parent


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    ).stdout


@pytest.mark.parametrize("module", ["robosim", "robosim.cli.main"])
def test_import_loads_nothing_heavy(module: str) -> None:
    code = f"import {module}, sys; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    assert run_python(code).split() == []


HEAVY = ["torch", "rerun", "pymunk", "matplotlib", "pyarrow", "pettingzoo", "pydantic", "scipy", "gymnasium"]


def test_simulating_and_running_a_policy_needs_neither_torch_nor_rerun() -> None:
    code = (
        "import robosim, sys; env = robosim.vector_env('paper', robots=2); env.reset(); "
        "robosim.make_controller('lanes').reset(env); robosim.load_policy; robosim.parallel_env; "
        "print(*(m for m in ['torch', 'rerun'] if m in sys.modules))"
    )
    assert run_python(code).split() == []


@pytest.mark.parametrize("name", robosim.__all__)
def test_every_public_name_loads(name: str) -> None:
    assert getattr(robosim, name) is not None
    assert name in dir(robosim)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'robosim' has no attribute 'teleport'"):
        robosim.teleport  # noqa: B018


@pytest.mark.parametrize("modules", ["robosim, gymnasium", "gymnasium, robosim", "robosim, gymnasium.spaces"])
def test_gymnasium_finds_the_environment_in_whichever_order_they_are_imported(modules: str) -> None:
    code = f"import {modules}; print(gymnasium.spec('robosim/Excavation-v0').entry_point)"
    assert run_python(code).strip() == "robosim.envs.gym_env:ExcavationEnv"


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [
        *project["dependencies"],
        *(r for extra in project["optional-dependencies"].values() for r in extra),
    ]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines if not line.startswith("#")}
    names = {name_of(requirement).lower().replace("_", "-") for requirement in wanted}
    assert names - {project["name"]} <= pinned


def name_of(requirement: str) -> str:
    for i, character in enumerate(requirement):
        if not (character.isalnum() or character in "-_."):
            return requirement[:i]
    return requirement
