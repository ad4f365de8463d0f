"""docs/noise.md says of every field what the code does."""

from pathlib import Path

from robosim.envs.profile import ProfileConfig, load_profile, profile_names
from robosim.records import allowed

PAGE = (Path(__file__).parents[2] / "docs" / "noise.md").read_text()


def test_the_page_has_every_field_with_its_default_and_what_is_allowed() -> None:
    for name in ("motion", "sensing", "pheromones"):
        part = getattr(ProfileConfig(), name)
        for own, field in type(part).model_fields.items():
            value = getattr(part, own)
            default = list(value) if isinstance(value, tuple) else value
            row = f"| `{name}.{own}` | {default} | {allowed(field)} | "
            assert row in PAGE, f"docs/noise.md lacks the row {row!r}"


def test_the_page_has_every_profile_and_its_example_is_one() -> None:
    for name in profile_names():
        assert f"| `{name}` | " in PAGE
    example = PAGE.split("```toml\n")[1].split("```")[0]
    profile = load_profile(example)
    assert profile == ProfileConfig(
        name="slow-link",
        description="Commands over a busy radio.",
        motion={"latency": (0.05, 0.15), "jitter": 0.05},
        sensing={"dropout": 0.1},
    )
