"""Sound messages that say anything, from those whom a process believes: nothing crashes."""

import random
import time
from contextlib import ExitStack
from io import StringIO

import numpy as np
import pytest

from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail
from robosim.deploy.link.messages import (
    LONGEST_TIME,
    NO_POSE,
    NORTH_UP,
    Body,
    Clock,
    Deposit,
    Field,
    Order,
    Pose,
    Reading,
    Rest,
    Stage,
    WheelCommand,
    patch_numbers,
)
from robosim.deploy.link.session import Link
from robosim.deploy.processes.pheromones import PheromoneService
from robosim.deploy.processes.world import AS_FAST_AS_ALL_ANSWER, WorldProcess
from robosim.deploy.simulated import SimulatedRobots
from robosim.errors import InputError
from tests.deploy.processes.team import ARENA, CONFIG, SETUP, link_config, robot_process, running

__all__ = ["link_config"]
MESSAGES = 250


def often(rng, likely, *others):
    """Return what is likely, or now and then something else."""
    return rng.choice(others) if rng.random() < 0.1 else likely


def drawn(rng, elapsed, driver, service):
    """Return the key and a message that is whole and in range; what it says is plausible, or anything."""
    x, y = rng.uniform(0.2, 2.0), rng.uniform(0.3, 0.5)
    number = often(rng, x, 0.0, 1e-9, 1e6, -1e6)
    seconds = often(rng, elapsed, 0.0, LONGEST_TIME if rng.random() < 0.05 else 0.0, elapsed - 1, elapsed + 3)
    seconds = max(seconds, 0.0)
    robot = rng.randrange(2)
    flags = [rng.random() < 0.5 for _ in range(5)]
    radius = often(rng, CONFIG.pheromone.radius, 0, 1, 60)
    decision = often(rng, int(elapsed / 0.3), 0, 1, 300, 2**32 - 1)
    hold, released = often(rng, 0, 5, 6), often(rng, 5, 6, 0)
    speed = often(rng, 1.0, 0.0, 0.01, 1000.0)
    stage = often(rng, Stage.RUNNING, Stage.WAITING)
    drivers = (driver, rng.choice([0, 7]))
    rest = (rng.choice(list(Rest)), Rest.UNKNOWN)
    cells = [often(rng, 3, 0, 65535), often(rng, 2, 65535)]
    facing, mode = often(rng, NORTH_UP, 0, 3), rng.randrange(7)
    pellet = rng.choice([None, (number, -number)])
    kinds = {
        "clock": Clock(SETUP, seconds, speed, stage, service, drivers, hold, released, rest, "é"),
        f"pose/{robot}": Pose(seconds, number, often(rng, y, -1e6), number, often(rng, 0.0, 0.3, 1e6)),
        "pose/0": Pose(seconds, *(often(rng, (x, y, 0.1), [np.nan] * 3))),
        "body/0": Body(seconds, flags[0], flags[1], tuple(flags[2:]), pellet),
        f"wheels/{robot}": WheelCommand(
            often(rng, seconds, NO_POSE), rng.uniform(-1e4, 1e4), 1e4, rng.choice([-1, 0, 1]), hold, rest[0]
        ),
        f"deposit/{robot}": Deposit(decision, *cells, facing, flags[0], mode, flags[1], often(rng, 4, 255)),
        "reading/0": Reading(decision, radius, 1.0, np.ones(patch_numbers(radius), np.float32)),
        "field": Field(decision, np.full((rng.randrange(3), rng.randrange(3)), 3e38, np.float32)),
        "order": Order(rng.choice([0, 5, 6]), "x" * rng.randrange(200)),
    }  # fmt: skip
    return rng.choice([*kinds.items()])


def pelt(rng, links, seconds):
    """Send messages on the links of those who are believed, for a while; `links` say who may send what."""
    limit = time.monotonic() + seconds
    for number in range(MESSAGES):
        key, message = drawn(rng, 0.03 * number, *links.names)
        for sender, topics in links.senders:
            if key.partition("/")[0] in topics and time.monotonic() < limit:
                sender.send(key, message, int(key.rpartition("/")[2]) if "/" in key else 0)
        time.sleep(0.001)


class Links:
    """Who sends what, and the instances that the clock names: driver of robot 0, and the service."""

    def __init__(self, names, *senders):
        self.names, self.senders = names, senders


TELLS = {"clock", "pose", "body"}


def test_a_robot_and_the_service_live_through_whatever_their_world_says(link_config):
    text = StringIO()
    with ExitStack() as stack:
        world = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        keeper = stack.enter_context(
            Link("pheromones", link_config, listen=link_config.map_at, connect=(link_config.world_at,))
        )
        service = PheromoneService(CONFIG, ARENA, SETUP, keeper, Lines("pheromones", text))
        robot = robot_process(0, link_config, stack, text)
        mail, commands = Mail(world, Lines("world", StringIO()), 2), []
        world.hear("wheels/0")
        links = Links((robot._link.instance, keeper.instance), (world, TELLS), (keeper, {"reading"}))
        with running(service.run, lambda ending: robot.run(ending, 10.0)) as failed:
            pelt(random.Random(1), links, 4.0)
        commands += [item.message for item in mail.take(0.1) if isinstance(item, Letter)]
    # That another process drives it, or the map is another's, are sentences.
    assert all(isinstance(error, InputError) for error in failed), failed
    # How many depends on how much time the machine leaves it.
    assert len(commands) > 2
    assert robot.decisions > 0
    limit = ARENA.robot.max_wheel_speed * (1 + 1e-9)
    assert max(max(abs(one.left), abs(one.right)) for one in commands) <= limit


@pytest.mark.parametrize("seed", [2])
def test_the_world_and_the_service_live_through_whatever_robots_say(link_config, seed):
    engine = SimulatedRobots(CONFIG, 5)
    connect = (link_config.world_at, link_config.map_at)
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        keeper = stack.enter_context(
            Link("pheromones", link_config, listen=link_config.map_at, connect=(link_config.world_at,))
        )
        own = stack.enter_context(Link("robot-0", link_config, connect=connect))
        frames = []
        world = WorldProcess(
            engine, SETUP, here, Lines("world", StringIO()), speed=AS_FAST_AS_ALL_ANSWER, needs_map=False,
            on_frame=lambda frame: frames.append(np.isfinite(frame.pose).all()),
        )  # fmt: skip
        service = PheromoneService(CONFIG, ARENA, SETUP, keeper, Lines("pheromones", StringIO()))
        own.appear(f"alive/robot/0/{own.instance:x}")
        links = Links(
            (own.instance, keeper.instance),
            (own, {"wheels", "deposit", "order"}),
            (keeper, {"field"}),
        )
        with running(service.run, lambda ending: world.run(100_000, ending, 0.1)) as failed:
            pelt(random.Random(seed), links, 4.0)
    assert failed == []
    assert len(frames) > 3
    assert all(frames)
    assert np.isfinite(engine.world.state.pose).all()
    assert np.isfinite(service.map.occupancy).all()
