"""tools/reproduce.py: what it runs, and how that ends."""

import importlib.util
import sys
from pathlib import Path

import pytest

from robosim.errors import InputError

TOOL = Path(__file__).parents[2] / "tools" / "reproduce.py"


def test_what_goes_wrong_in_a_sweep_is_its_exit_code(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("reproduce", TOOL)
    tool = importlib.util.module_from_spec(spec)
    # Where its dataclasses look for it.
    monkeypatch.setitem(sys.modules, "reproduce", tool)
    spec.loader.exec_module(tool)
    assert tool.robosim("sweep", str(tmp_path / "nowhere.toml")) == 2
    with pytest.raises(InputError, match='no sweep is named "gird": did you mean grid'):
        tool.run(["gird"], [])
