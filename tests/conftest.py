"""What every test shares: repeatable hypothesis runs, and arithmetic that no test leaves changed."""

import sys
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "robosim", max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("robosim")


@pytest.fixture(autouse=True)
def _subnormal_numbers() -> Iterator[None]:
    """Learning turns subnormal numbers off for its whole process; hypothesis needs them."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_flush_denormal(False)
