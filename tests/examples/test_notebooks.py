"""The notebooks are kept without output, and every cell of them runs; with smaller sizes than a reader's."""

import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

SMALLER = {
    "run_a_team": {"DECISIONS = 600": "DECISIONS = 30"},
    "train_ppo": {"STEPS = 60_000": "STEPS = 1024", "TEST_STEPS = 1000": "TEST_STEPS = 15"},
    "read_a_report": {"DECISIONS = 1200": "DECISIONS = 100"},
}
NAMES = sorted(SMALLER)


@pytest.fixture
def notebooks(examples, monkeypatch):
    monkeypatch.setattr(plt, "show", lambda: None)
    plt.switch_backend("agg")
    yield examples / "notebooks"
    plt.close("all")


def read(folder: Path, name: str) -> dict:
    """The notebook, with smaller sizes."""
    notebook = json.loads((folder / f"{name}.ipynb").read_text(encoding="utf-8"))
    code = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for size, smaller in SMALLER[name].items():
        pattern = re.compile(rf"^{re.escape(size)}$", re.MULTILINE)
        assert sum(len(pattern.findall(text)) for text in code) == 1
        for cell in notebook["cells"]:
            cell["source"] = pattern.sub(smaller, "".join(cell["source"]))
    return notebook


def test_every_notebook_is_tested_and_kept_without_output(notebooks) -> None:
    assert sorted(path.stem for path in notebooks.glob("*.ipynb")) == NAMES
    for name in NAMES:
        for cell in read(notebooks, name)["cells"]:
            assert cell.get("outputs", []) == []
            assert cell.get("execution_count") is None


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_cell_runs(notebooks, name) -> None:
    names: dict[str, object] = {}
    for number, cell in enumerate(read(notebooks, name)["cells"]):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{name}, cell {number}", "exec"), names)
    if name == "train_ppo":
        assert names["model"].num_timesteps == 1024
        assert len(names["learned"]) == len(names["by_chance"]) == 3
    if name == "run_a_team":
        assert names["places"].shape == (30, 4, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_runs_in_a_kernel_and_shows_something(notebooks, name) -> None:
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.from_dict(read(notebooks, name))
    nbformat.validate(notebook)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(notebooks)}}).execute()
    kinds = {
        kind
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        for kind in output.get("data", {"text/plain": ""})
    }
    assert kinds >= {"run_a_team": {"text/html", "image/png"}, "train_ppo": {"text/plain"}}.get(
        name, {"text/html", "image/png", "text/plain"}
    )
