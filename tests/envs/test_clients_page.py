"""docs/clients.md shows what tools/compare_faces.py measures."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("compare_faces", ROOT / "tools" / "compare_faces.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["compare_faces"] = module
    spec.loader.exec_module(module)
    return module


def test_the_page_has_the_lines_of_every_client_and_counts_them(tool):
    page = (ROOT / "docs" / "clients.md").read_text(encoding="utf-8")
    for face in tool.FACES:
        assert face.lines == len([line for line in face.code.splitlines() if line])
        assert f"\n| {face.client} | {face.lines} | " in page
        # The floor, and single environments where there is a batch, are in the table alone.
        if (face.num_envs > 1 and face.needs != "robosim") or face.needs == "ray":
            assert f"```python\n{face.code}\n```" in page


def test_what_is_installed_is_measured_with_the_same_robots_and_environments(tool):
    faces = [face for face in tool.FACES if face.needs in {"robosim", "gymnasium", "pettingzoo"}]
    assert len(faces) == 3
    measured = tool.measure(faces, seconds=0.0, rounds=1)
    assert all(set(one.speeds) == {"physics", "grid"} for one in measured)
    rows = list(tool.table(measured))
    assert len(rows) == 2 + 3
    assert rows[2].startswith("| `robosim.vector_env`, the floor | 2 | ")
    assert rows[2].count("100%") == 2
