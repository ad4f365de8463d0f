"""The rules of the link: only a robot's own process may send its wheel commands."""

import json
from pathlib import Path

import pytest

from robosim.deploy.link.access import (
    LinkConfig,
    access_control,
    nested,
    robot_name,
    settings_table,
    statements,
)
from robosim.errors import InputError

EXAMPLES = Path(__file__).parents[3] / "examples" / "link"


def may_say(rules, flow, other, key):
    """Whether Zenoh's `access_control` lets `other` and this process exchange what is put on a key."""
    mine = next((policy["rules"] for policy in rules["policies"] if other in policy["subjects"]), [])
    return any(
        rule["id"] in mine
        and flow in rule["flows"]
        and "put" in rule["messages"]
        and key in [one.replace("/*", "/1") for one in rule["key_exprs"]]
        for rule in rules["rules"]
    )


def test_wheel_commands_are_said_by_the_robots_own_process_to_the_world_alone():
    wheels = [(who, to, key) for who, to, key in statements(3) if key.startswith("wheels")]
    assert wheels == [(f"robot-{robot}", "world", f"wheels/{robot}") for robot in range(3)]


def test_the_operator_alone_orders_and_the_world_alone_is_told():
    assert [one for one in statements(3) if one[2] == "order"] == [("operator", "world", "order")]
    assert [one for one in statements(3) if "operator" in one[:2]] == [
        ("operator", "world", "order"),
        ("world", "operator", "clock"),
    ]
    world = access_control("world", "robosim/team", 3)
    assert may_say(world, "ingress", "operator", "robosim/team/order")
    for other in ("robot-0", "pheromones"):
        assert not may_say(world, "ingress", other, "robosim/team/order")


def test_robots_have_nothing_to_say_to_each_other():
    robots = {robot_name(robot) for robot in range(8)}
    assert not [(who, to) for who, to, _ in statements(8) if who in robots and to in robots]


def test_a_process_enforces_what_it_takes_in_and_what_it_gives_out():
    world = access_control("world", "robosim/team", 3)
    assert world["enabled"]
    assert world["default_permission"] == "deny"
    for robot in range(3):
        for other in range(3):
            key = f"robosim/team/wheels/{other}"
            assert may_say(world, "ingress", f"robot-{robot}", key) == (robot == other)
            assert not may_say(world, "egress", f"robot-{robot}", key)
        assert may_say(world, "egress", f"robot-{robot}", "robosim/team/pose/1")
        assert not may_say(world, "ingress", f"robot-{robot}", "robosim/team/pose/1")
        assert not may_say(world, "ingress", f"robot-{robot}", "robosim/team/clock")
    assert {one["cert_common_names"][0] for one in world["subjects"]} == {
        "operator", "pheromones", "robot-0", "robot-1", "robot-2",
    }  # fmt: skip
    robot = access_control("robot-1", "robosim/team", 3)
    assert [one["id"] for one in robot["subjects"]] == ["pheromones", "world"]
    assert may_say(robot, "ingress", "pheromones", "robosim/team/reading/1")
    assert not may_say(robot, "ingress", "pheromones", "robosim/team/clock")


@pytest.mark.parametrize("name", ["world", "pheromones", "robot-0", "operator"])
def test_the_files_that_ship_are_what_processes_use(name, tmp_path):
    """They name the files of a folder `keys` without its place."""
    config = LinkConfig(keys=str(tmp_path))
    for file in ("ca.pem", f"{name}.pem", f"{name}.key"):
        (tmp_path / file).touch()
    listen = {"world": config.world_at, "pheromones": config.map_at}.get(name, "")
    to_world = (config.world_at,)
    connect = {"world": (), "pheromones": to_world, "operator": to_world}.get(
        name, (config.world_at, config.map_at)
    )
    table = nested(settings_table(name, config, listen, connect, 8))
    text = json.dumps(table, indent=2).replace(str(tmp_path.resolve()), "keys")
    assert (EXAMPLES / f"{name}.json5").read_text() == text + "\n"


def test_missing_keys_and_wrong_places_are_said_in_a_sentence(tmp_path):
    with pytest.raises(
        InputError, match=r"ca\.pem: not found; the folder of keys must hold ca\.pem, world\.pem"
    ):
        settings_table("world", LinkConfig(keys=str(tmp_path)), "", (), 1)
    for table, said in (
        ({"world_at": "somewhere"}, 'link: world_at: "somewhere" is no address: it must be HOST:PORT.'),
        (
            {"team": "a/**"},
            'link: team: "a/**" is no name: it must be of 1 to 40 of a to z, 0 to 9, _ and -.',
        ),
    ):
        with pytest.raises(InputError) as caught:
            LinkConfig.from_table(table, "link")
        assert str(caught.value) == said
