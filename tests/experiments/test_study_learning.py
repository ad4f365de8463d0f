import importlib.util
import sys
from pathlib import Path

import pytest

from robosim.experiments.results import Result

TOOL = Path(__file__).parents[2] / "tools" / "study_learning.py"


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("study_learning", TOOL)
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table(study):
    def result(*pellets):
        return Result("", {}, {"pellets": pellets}, 0.0, {})

    results = [result(10.0, 20.0), result(21.0, 21.0), result(5.0), None]
    assert list(study.table([{}, {"encoding": "paper", "seed": 1}], results)) == [
        "| changed | pellets in an episode | between seeds | worst seed |",
        "|---|---|---|---|",
        "| nothing | 18.0 | 4.2 | 15.0 |",
        "| `encoding` paper, `seed` 1 | 1 of 2 seeds failed | | |",
    ]


def test_every_variant_is_a_configuration(study):
    for changes in (*study.OPEN, *study.OURS):
        study.run_config(**changes)
