from robosim.arena import load_arena
from robosim.control.policy import load_policy
from robosim.learning.config import run_config
from robosim.learning.training import starting_team


def test_a_team_for_the_robots_of_the_example_can_go_on_from_the_one_for_all(examples):
    path = examples / "robots" / "burger.toml"
    sheet = load_arena(path).robot
    # What the makers say: 0.22 m/s, and 2.84 rad/s, nearly.
    assert round(sheet.top_speed, 3) == 0.22
    assert 2.7 < 2 * sheet.top_speed / sheet.wheel_base < 2.84
    config = run_config(technique="ps-ippo", arena=str(path), robots=4, hidden=(256, 256), start_from="any")
    _, actors = starting_team(config, load_policy("any"))
    assert actors.spec.robots == 4
