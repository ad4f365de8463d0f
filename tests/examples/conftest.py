from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def examples(monkeypatch):
    """The folder of the examples, from which they import each other as they do when run as scripts."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return EXAMPLES
