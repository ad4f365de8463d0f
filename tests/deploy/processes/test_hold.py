"""The emergency stop of a team: it holds whoever hears it, and only its own release ends it."""

import random

from robosim.deploy.link.messages import NOBODY, Order
from robosim.deploy.processes.hold import ANOTHER, OVER, RobotHold, TeamHold


def test_an_order_holds_and_only_its_own_release_ends_it():
    team = TeamHold()
    assert team.take(7, Order(reason="smoke")) == ("", "emergency stop: smoke; holds all robots")
    assert team.take(7, Order(reason="smoke")) == ("", "")
    assert team.take(8, Order(release=6)) == (ANOTHER, "")
    assert team.hold == 7
    assert team.take(8, Order(release=7)) == ("", "the emergency stop is released; robots go on")
    assert team.take(8, Order(release=7)) == ("", "")
    assert (team.hold, team.released) == (NOBODY, 7)
    # Doubled or late, it does not begin anew.
    assert team.take(7, Order(reason="smoke")) == (OVER, "")
    assert team.hold == NOBODY


def test_a_late_release_does_not_end_a_newer_stop():
    team = TeamHold()
    team.take(7, Order())
    team.take(9, Order())
    assert team.take(8, Order(release=7)) == (ANOTHER, "")
    assert team.hold == 9


def test_a_new_world_takes_over_what_holds_the_robots():
    robot, world = RobotHold(), TeamHold()
    assert robot.take(7, NOBODY) is True
    # A world that knows nothing does not release it.
    assert robot.take(NOBODY, NOBODY) is None
    assert world.heard(3, robot.hold).startswith("robot 3 comes held by an emergency stop of an earlier run")
    assert world.hold == 7
    world.take(8, Order(release=7))
    # What has not heard of the release yet does not hold all anew.
    assert world.heard(3, robot.hold) == ""
    assert robot.take(world.hold, world.released) is False
    assert robot.hold == NOBODY


def test_whatever_comes_in_whatever_order_nobody_drives_while_the_team_is_held():
    """Orders lost, doubled and late, worlds that begin anew, robots that join: by a seeded loop."""
    rng = random.Random(0)
    for _ in range(300):
        world, robots = TeamHold(), [RobotHold() for _ in range(3)]
        sent = []
        for step in range(30):
            act = rng.randrange(6)
            if act == 0:
                sent.append((100 + step, Order()))
            elif act == 1 and world.hold != NOBODY:
                sent.append((100 + step, Order(release=world.hold)))
            elif act == 2 and rng.random() < 0.2:
                world = TeamHold()
            elif act == 3 and rng.random() < 0.2:
                robots[rng.randrange(3)] = RobotHold()
            if sent and rng.random() < 0.8:
                world.take(*rng.choice(sent))
            for number, robot in enumerate(robots):
                if rng.random() < 0.7:
                    world.heard(number, robot.hold)
                before = robot.hold
                change = robot.take(world.hold, world.released)
                assert (change is False) == (before != NOBODY and robot.hold == NOBODY)
                if change is False:
                    assert world.released == before
                if world.hold != NOBODY:
                    assert robot.hold == world.hold
