"""What every test shares: repeatable hypothesis runs."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "robosim", max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("robosim")
