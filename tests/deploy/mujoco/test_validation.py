"""The second physics by itself does what the data sheet says."""

import pytest

pytest.importorskip("mujoco")

from robosim.deploy.mujoco import MujocoWorld
from robosim.deploy.mujoco.validation import EXPERIMENTS


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda one: one.name)
def test_mujoco_is_as_the_data_sheet_says(experiment) -> None:
    found, expected = experiment.measure(MujocoWorld), experiment.expected
    print(f"{experiment.name}: {found:.4f} {experiment.unit}, expected {expected:.4f}")
    allowed = experiment.tolerance * (expected or 1.0)
    assert abs(found - expected) <= allowed
