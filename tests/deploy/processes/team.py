"""A team of two on a real link, its processes as threads."""

import threading
import time
from contextlib import contextmanager
from io import StringIO

import pytest

from robosim.control.policy import load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.link.access import LinkConfig
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.session import Link
from robosim.deploy.link.setup import setup_number
from robosim.deploy.processes.launch import free_addresses
from robosim.deploy.processes.robot import RobotProcess
from robosim.deploy.processes.stopping import Ending

POLICY = load_policy("paper-2-smadrl")
CONTROLLER = Controller(POLICY)
CONFIG = CONTROLLER.config.changed(pellet_gradient=0.0, profile=None)
ARENA = CONTROLLER.arena
SETUP = setup_number(CONFIG)


@contextmanager
def running(*jobs):
    """Run processes as threads until the block ends; what they raise is raised then."""
    ending, failed = Ending(), []

    def run(job):
        try:
            job(ending)
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=run, args=(job,)) for job in jobs]
    for thread in threads:
        thread.start()
    try:
        yield failed
    finally:
        ending.asked = True
        for thread in threads:
            thread.join(10.0)


def until(holds, timeout=30.0):
    """Wait until something holds; whether it has in time."""
    limit = time.monotonic() + timeout
    while not holds() and time.monotonic() < limit:
        time.sleep(0.005)
    return holds()


@pytest.fixture
def link_config():
    world_at, map_at = free_addresses(2)
    return LinkConfig(team="test", world_at=world_at, map_at=map_at)


def robot_process(number, config, stack, text=None, policy=POLICY, plays=CONFIG, log=None):
    link = stack.enter_context(
        Link(f"robot-{number}", config, connect=(config.world_at, config.map_at), robots=plays.robots)
    )
    lines = Lines(f"robot {number}", text or StringIO())
    arena = Controller(policy).arena
    return RobotProcess(policy, number, plays, arena, link, lines, log=log)
