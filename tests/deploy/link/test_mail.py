"""What arrives by a real link is read, or counted with the reason why not."""

import time
from io import StringIO

from robosim.deploy.link.access import LinkConfig
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail, Token
from robosim.deploy.link.messages import MOST_BYTES, Pose, WheelCommand, pack
from robosim.deploy.link.session import Link
from robosim.deploy.processes.launch import free_addresses

COMMAND = WheelCommand(0.0, 1.0, 2.0, 0)


def test_sound_messages_and_tokens_come_in_order_and_the_rest_is_counted():
    (place,) = free_addresses(1)
    config, text = LinkConfig(world_at=place), StringIO()
    lines = Lines("world", text)
    with Link("world", config, listen=place) as here, Link("robot-1", config, connect=(place,)) as there:
        here.hear("**")
        here.watch("alive/**")
        mail = Mail(here, lines, robots=2)
        there.appear(f"alive/robot/1/{there.instance:x}")
        there.appear("alive/robot/7/1")
        there.appear("alive/robot/1/what")
        got, limit = [], time.monotonic() + 10.0
        while not got and time.monotonic() < limit:
            got += [item for item in mail.take(0.1) if isinstance(item, Token)]
        assert got == [Token("robot", 1, there.instance, there=True)]
        there.send("wheels/1", COMMAND, 1)
        there.send("wheels/0", COMMAND, 1)
        there.send("wheels/1", Pose(0.0, 0.0, 0.0, 0.0), 1)
        there.send("elsewhere", COMMAND, 1)
        there.send_raw("wheels/5", pack(COMMAND, 5, 3, 1, 0.0))
        there.send_raw("wheels/1", b"")
        there.send_raw("wheels/1", bytes(MOST_BYTES + 1))
        there.send("wheels/1", COMMAND, 1)
        letters = []
        # Tokens come by themselves: wrong ones may be heard after the last letter.
        while (len(letters) < 2 or len(lines.dropped) < 8) and time.monotonic() < limit:
            letters += [item for item in mail.take(0.1) if isinstance(item, Letter)]
    assert [(one.key, one.header.sequence, one.message) for one in letters] == [
        ("wheels/1", 1, COMMAND),
        ("wheels/1", 3, COMMAND),
    ]
    assert lines.dropped == {
        "wheels/0: of another robot": 1,
        "wheels/1: of a kind that does not belong there": 1,
        "elsewhere: of a kind that does not belong there": 1,
        "wheels/5: of a robot that is not in the team": 1,
        "wheels/1: too short": 1,
        "wheels/1: too long": 1,
        "alive/robot/7/1: of a robot that is not in the team": 1,
        "alive/robot/1/what: not a token of robosim": 1,
    }
    said = text.getvalue().splitlines()
    assert len(said) == len(lines.dropped)
    assert any(line.endswith("world: dropped 1 message on wheels/1: too long") for line in said)


def test_what_is_dropped_is_said_once_in_a_while_and_in_all_at_the_end():
    text = StringIO()
    lines = Lines("world", text)
    for _ in range(500):
        lines.drop("wheels/0", "too short")
    assert len(text.getvalue().splitlines()) == 1
    lines.sum_up()
    assert text.getvalue().splitlines()[-1].endswith("world: dropped in all: 500 on wheels/0: too short")
    for number in range(3000):
        lines.drop(f"made up {number}", "too short")
    assert len(lines.dropped) == 1001
    assert lines.dropped["other keys"] == 3000 - 999
