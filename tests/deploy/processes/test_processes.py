"""The processes of a team on a real link: who is obeyed, what stops a robot, and what comes of it."""

import hashlib
import time
from contextlib import ExitStack, closing
from io import StringIO

import numpy as np
import pytest

from robosim.cli.main import main
from robosim.control.policy import load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.link.disturbance import Disturbance
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail
from robosim.deploy.link.messages import (
    MOST_BYTES,
    Body,
    Clock,
    Pose,
    Reading,
    Stage,
    WheelCommand,
    patch_numbers,
)
from robosim.deploy.link.session import Link
from robosim.deploy.link.setup import setup_number
from robosim.deploy.log import DecisionLog, open_log
from robosim.deploy.processes import pheromones as service_module
from robosim.deploy.processes import robot as robot_module
from robosim.deploy.processes.launch import free_addresses
from robosim.deploy.processes.pheromones import PheromoneService
from robosim.deploy.processes.stopping import Ending
from robosim.deploy.processes.world import AS_FAST_AS_ALL_ANSWER, WorldProcess
from robosim.deploy.simulated import SimulatedRobots
from robosim.discretise.modes import Mode
from robosim.envs.config import env_config
from robosim.errors import InputError
from robosim.robot.drivers import STOP, Cardinal
from tests.deploy.made import make_policy
from tests.deploy.processes.team import (
    ARENA,
    CONFIG,
    SETUP,
    link_config,
    robot_process,
    running,
    until,
)

__all__ = ["link_config"]


def team_on_a_link(config, decisions, policy, plays, profile, logs=None):
    """Run a team as threads; return what came of it, frames, decisions, what was late, and what was said."""
    frames, text = [], StringIO()
    arena, setup = Controller(policy).arena, setup_number(plays)
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", config, listen=config.world_at))
        there = stack.enter_context(
            Link("pheromones", config, listen=config.map_at, connect=(config.world_at,))
        )
        service = PheromoneService(plays, arena, setup, there, Lines("pheromones", text))
        robots = [
            robot_process(
                number,
                config,
                stack,
                text,
                policy,
                plays,
                logs and stack.enter_context(closing(DecisionLog(logs / f"{number}.jsonl", number))),
            )
            for number in range(plays.robots)
        ]
        world = WorldProcess(
            SimulatedRobots(env_config(plays, profile=profile)[0], 5),
            setup,
            here,
            Lines("world", text),
            speed=AS_FAST_AS_ALL_ANSWER,
            on_frame=lambda frame: frames.append((frame.step, frame.pheromone.max(), frame.reward)),
        )
        jobs = [lambda ending, robot=robot: robot.run(ending, 10.0) for robot in robots]
        with running(service.run, *jobs) as failed:
            ran = world.run(decisions, Ending(), 10.0)
    # On a busy machine a robot may give up waiting for the world.
    assert all(isinstance(error, InputError) for error in failed), failed
    late = len(failed) + ran.lost + sum(ran.stopped) + service.lost + service.incomplete
    late += sum(robot.lost + robot.early + robot.unanswered for robot in robots)
    return ran, frames, [robot.decisions for robot in robots], late, text.getvalue()


@pytest.mark.parametrize(
    ("name", "profile"), [("paper-2-smadrl", None), ("relay-4", "robotarium")], ids=["equals", "mixed, noisy"]
)
def test_a_team_of_processes_drives_as_one_process_does_to_the_bit(link_config, tmp_path, name, profile):
    """Unless messages get lost or late, which is counted, and may happen on a busy machine."""
    decisions = 8
    policy = load_policy(name)
    controller = Controller(policy)
    plays = controller.config.changed(pellet_gradient=0.0, profile=None)
    one = SimulatedRobots(env_config(plays, profile=profile)[0], 5)
    trajectory = hashlib.sha256()
    for _ in range(decisions):
        for _ in range(3):
            one.obey(controller.step(one.readings(), one.now))
        trajectory.update(one.world.state.pose[0].tobytes())
    for attempt in range(2):
        logs = tmp_path / str(attempt)
        logs.mkdir()
        ran, frames, decided, late, text = team_on_a_link(
            link_config, decisions, policy, plays, profile, logs
        )
        if late == 0:
            break
    else:
        pytest.skip(
            f"the machine is too busy: in four runs messages came late or not at all, {late} in the last"
        )
    assert ran.trajectory == trajectory.hexdigest(), text
    assert [step for step, _, _ in frames] == list(range(decisions + 1))
    assert frames[-1][1] > 0.1
    # Nobody works rewards out here, so none are shown.
    assert all(np.isnan(reward).all() for _, _, reward in frames)
    assert decided == [decisions] * plays.robots
    log = open_log(logs / "1.jsonl")
    assert (log.head.robot, log.head.map) == (1, "shared")
    assert sum(logged.actions is not None for logged in log.periods) == decisions


def test_a_team_is_held_and_released_over_the_link_and_who_comes_late_hears_it(link_config):
    """By the commands that operators type; the world gives a held team nothing, too."""
    text = StringIO()
    engine = SimulatedRobots(CONFIG, 5)
    stop = ["--world-at", link_config.world_at, "--team", "test", "--patience", "30"]
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        there = stack.enter_context(
            Link("pheromones", link_config, listen=link_config.map_at, connect=(link_config.world_at,))
        )
        service = PheromoneService(CONFIG, ARENA, SETUP, there, Lines("pheromones", StringIO()))
        world = WorldProcess(engine, SETUP, here, Lines("world", text), speed=5.0)
        links = stack.enter_context(ExitStack())
        stays = robot_process(0, link_config, stack, text)
        goes = robot_process(1, link_config, links, text)
        first = Ending()
        jobs = [lambda ending: stays.run(ending, 10.0), lambda ending: goes.run(first, 10.0)]
        with running(service.run, lambda ending: world.run(100_000, ending, 10.0), *jobs) as failed:
            assert until(lambda: engine.now > 1.0)
            assert main(["deploy", "stop", "--reason", "smoke", *stop]) == 0, text.getvalue()
            rest = engine.world.state.pose[0].copy()
            held_at = engine.now
            first.asked = True
            assert until(lambda: "robot 1: ends: asked to end" in text.getvalue())
            links.close()
            assert until(lambda: "robot 1 is driven by nobody" in text.getvalue())
            late = robot_process(1, link_config, stack, text)
            with running(lambda ending: late.run(ending, 10.0)):
                assert until(lambda: text.getvalue().count("stopped: emergency stop: smoke") == 3)
                assert until(lambda: engine.now > held_at + 1.0)
                np.testing.assert_allclose(engine.world.state.pose[0], rest, atol=1e-3)
                assert main(["deploy", "release", *stop]) == 0
                assert until(lambda: np.abs(engine.world.state.pose[0] - rest).max(axis=1).min() > 0.02)
    assert failed == []
    said = text.getvalue()
    assert "world: emergency stop: smoke; holds all robots" in said
    assert said.count("the emergency stop is released") == 3
    assert "robot 0: stands" in said


@pytest.fixture
def without_map(tmp_path):
    """A policy of two robots that reads no pheromones and drives north, what it plays, and its setup."""

    def north(spec):
        weights = {name: np.zeros(shape, np.float32) for name, shape in spec.shapes.items()}
        weights["layer2.bias"][:, 0] = 1.0
        return weights

    made = make_policy(tmp_path / "made", 2, north, env={"stigmergy": False}, of_robot=(0, 1))
    policy = load_policy(made)
    plays = Controller(policy).config.changed(pellet_gradient=0.0, profile=None)
    return policy, plays, setup_number(plays)


def test_the_picture_shows_what_robots_do_that_read_no_pheromones(link_config, without_map):
    policy, plays, setup = without_map
    frames = []
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        robots = [
            robot_process(number, link_config, stack, policy=policy, plays=plays) for number in range(2)
        ]
        world = WorldProcess(
            SimulatedRobots(plays, 5),
            setup,
            here,
            Lines("world", StringIO()),
            speed=4.0,
            needs_map=False,
            on_frame=lambda frame: frames.append((frame.mode.tolist(), frame.action.tolist())),
        )
        with running(*(lambda ending, robot=robot: robot.run(ending, 10.0) for robot in robots)) as failed:
            world.run(40, Ending(), 10.0)
    assert failed == []
    assert frames[0] == ([Mode.GOING_TO_DIG] * 2, [STOP] * 2)
    assert frames[-1][1] == [Cardinal.NORTH] * 2
    # Against the wall a robot is now in collision, now not.
    assert all(any(mode[robot] == Mode.COLLISION for mode, _ in frames) for robot in range(2))


def test_robots_hear_of_the_end_over_a_link_that_is_late(link_config, without_map):
    """However much they say themselves; what is under way as the world's process ends is lost."""
    policy, plays, setup = without_map
    text = StringIO()
    with ExitStack() as stack:
        late = Disturbance(delay=0.15)
        here = Link("world", link_config, listen=link_config.world_at, disturbance=late)
        links = stack.enter_context(ExitStack())
        links.enter_context(here)
        robots = [
            robot_process(number, link_config, stack, text, policy=policy, plays=plays) for number in range(2)
        ]
        engine = SimulatedRobots(plays, 5)
        world = WorldProcess(engine, setup, here, Lines("world", StringIO()), speed=4.0, needs_map=False)
        with running(*(lambda ending, robot=robot: robot.run(ending, 10.0) for robot in robots)) as failed:
            world.run(8, Ending(), 10.0)
            links.close()
            assert until(lambda: text.getvalue().count("ends: the world has ended") == 2, 5.0)
    assert failed == []


@pytest.mark.slow
def test_a_slow_world_is_not_taken_for_a_silent_one(link_config, without_map, capsys):
    """A control period of it takes longer than a process may be silent."""
    policy, plays, setup = without_map
    engine = SimulatedRobots(plays, 5)
    stop = ["--world-at", link_config.world_at, "--team", "test", "--patience", "30"]
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        robots = [
            robot_process(number, link_config, stack, policy=policy, plays=plays) for number in range(2)
        ]
        world = WorldProcess(engine, setup, here, Lines("world", StringIO()), speed=0.15, needs_map=False)
        jobs = [lambda ending, robot=robot: robot.run(ending, 10.0) for robot in robots]
        with running(lambda ending: world.run(1000, ending, 10.0), *jobs) as failed:
            assert until(lambda: engine.now > 0.3)
            assert main(["deploy", "stop", *stop]) == 0
            assert main(["deploy", "release", *stop]) == 0
    assert failed == []
    assert capsys.readouterr().out.splitlines()[-1] == "the team is released"


def test_an_operator_is_told_who_did_not_stop_and_that_nobody_heard(link_config, capsys):
    engine = SimulatedRobots(CONFIG, 5)
    start = engine.world.state.pose[0].copy()
    operator = ["--world-at", link_config.world_at, "--team", "test", "--patience", "0.3"]
    assert main(["deploy", "stop", *operator]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "robosim: no world is heard, after 0.3 s, so nobody was stopped by this."
    )
    operator[-1] = "1"
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        runaway = stack.enter_context(Link("robot-0", link_config, connect=(link_config.world_at,)))
        runaway.appear(f"alive/robot/0/{runaway.instance:x}")
        world = WorldProcess(engine, SETUP, here, Lines("world", StringIO()), speed=4.0, needs_map=False)

        def drive(ending):
            while not ending.asked:
                runaway.send("wheels/0", WheelCommand(0.0, 6.0, 6.0, 0), 0)
                time.sleep(0.02)

        with running(lambda ending: world.run(100_000, ending, 0.2), drive):
            assert until(lambda: np.abs(engine.world.state.pose[0, 0] - start[0]).max() > 0.01)
            assert main(["deploy", "stop", *operator]) == 1
            rest = engine.world.state.pose[0].copy()
            held_at = engine.now
            assert until(lambda: engine.now > held_at + 1.0)
            np.testing.assert_allclose(engine.world.state.pose[0], rest, atol=2e-3)
            assert main(["deploy", "release", *operator]) == 0
            assert main(["deploy", "release", *operator]) == 0
    err = capsys.readouterr()
    assert err.err.splitlines()[-1] == (
        "robosim: the world holds all 2 robots, but robot 0 has not said that it holds; robot 1 has no "
        "process; all stay held until they are released."
    )
    assert err.out.splitlines() == ["the team is released", "no emergency stop holds the team"]


class WorldByHand:
    """The world's end of the link, for a robot to be told what a test wants."""

    def __init__(self, link):
        self.link = link
        self.mail = Mail(link, Lines("world", StringIO()), 2)
        self.driver = 0
        self.time = 0.0
        self.commands = []
        self.patch = np.zeros(patch_numbers(CONFIG.pheromone.radius), np.float32)
        link.appear(f"alive/pheromones/{link.instance:x}")
        link.hear("wheels/0")
        link.watch("alive/**")

    def tell(self, seconds, *, stage=Stage.RUNNING, poses=True, speed=1.0):
        """Publish what a world does, for a while."""
        place = SimulatedRobots(CONFIG, 5).readings().pose
        limit = time.monotonic() + seconds
        while time.monotonic() < limit:
            if stage == Stage.RUNNING:
                self.time += 0.1
            self.link.send("body/0", Body(self.time, False, False, (False, False, False), None), 0)
            for robot in range(2 * poses):
                self.link.send(f"pose/{robot}", Pose(self.time, *place[robot].tolist()), robot)
            reading = Reading(10**6, CONFIG.pheromone.radius, 0.0, self.patch)
            self.link.send("reading/0", reading, 0)
            self.link.send(
                "clock", Clock(SETUP, self.time, speed, stage, self.link.instance, (self.driver, 0))
            )
            self.hear(0.02)

    def hear(self, seconds):
        limit = time.monotonic() + seconds
        while (left := limit - time.monotonic()) > 0:
            for item in self.mail.take(left):
                if isinstance(item, Letter) and isinstance(item.message, WheelCommand):
                    self.commands.append(item)
                elif not isinstance(item, Letter) and item.there and item.role == "robot":
                    self.driver = self.driver or item.instance

    def moving(self):
        """When commands arrived that move the robot."""
        return [
            letter.at for letter in self.commands if (letter.message.left, letter.message.right) != (0, 0)
        ]

    def tell_until_it_moves(self):
        self.commands.clear()
        for _ in range(30):
            self.tell(0.1)
            if self.moving():
                return True
        return False


@pytest.fixture
def by_hand(link_config):
    with Link("world", link_config, listen=link_config.world_at) as link:
        yield WorldByHand(link)


def test_a_robot_stops_when_its_pose_gets_old_and_goes_on_when_it_is_seen_again(by_hand, link_config):
    text = StringIO()
    with (
        ExitStack() as stack,
        running(lambda ending: robot_process(0, link_config, stack, text).run(ending, 10.0)),
    ):
        while not by_hand.commands:
            by_hand.tell(0.1, stage=Stage.WAITING)
        assert not by_hand.moving()
        assert by_hand.tell_until_it_moves(), text.getvalue()
        # The clock and the sensors go on, only the tracker has lost it.
        blind = time.monotonic()
        by_hand.commands.clear()
        by_hand.tell(0.9, poses=False)
        assert 0.3 < max(by_hand.moving()) - blind < 0.8
        assert by_hand.commands[-1].at - blind > 0.8
        assert by_hand.tell_until_it_moves(), text.getvalue()
    assert "stopped: pose of 0." in text.getvalue()
    assert "goes on" in text.getvalue()
    # Asked to end, it commands the wheels to stand.
    by_hand.hear(0.2)
    assert by_hand.commands[-1].at not in by_hand.moving()


def test_a_second_process_of_one_name_ends_with_a_sentence(by_hand, link_config, monkeypatch):
    monkeypatch.setattr(robot_module, "TAKEOVER", 0.2)
    by_hand.driver = 99
    with ExitStack() as stack:
        second = robot_process(0, link_config, stack)
        with running(lambda ending: second.run(ending, 10.0)) as failed:
            while not failed:
                by_hand.tell(0.1)
    assert [type(error) for error in failed] == [InputError]
    assert str(failed[0]) == (
        "robot 0: another process drives this robot; end it before another one is started."
    )


def test_a_process_of_another_team_refuses_to_join(by_hand, link_config):
    config = CONFIG.with_options(pheromone_decay=0.3)
    assert setup_number(config) != SETUP
    with Link("pheromones", link_config, listen=link_config.map_at, connect=(link_config.world_at,)) as link:
        service = PheromoneService(config, ARENA, setup_number(config), link, Lines("pheromones", StringIO()))
        with running(service.run) as failed:
            while not failed:
                by_hand.tell(0.1, stage=Stage.WAITING)
    assert str(failed[0]) == (
        "pheromones: the world plays another arena, team or pheromones than this process was started with; "
        "give all processes the same POLICY, --arena and --robots."
    )


def test_a_second_service_ends_with_a_sentence(by_hand, link_config, monkeypatch):
    monkeypatch.setattr(service_module, "TAKEOVER", 0.2)
    with Link("pheromones", link_config, listen=link_config.map_at, connect=(link_config.world_at,)) as link:
        service = PheromoneService(CONFIG, ARENA, SETUP, link, Lines("pheromones", StringIO()))
        with running(service.run) as failed:
            while not failed:
                by_hand.tell(0.1, stage=Stage.WAITING)
    assert str(failed[0]) == (
        "pheromones: another service has the team's map; end it before another one is started."
    )


def test_wheels_obey_one_process_and_only_as_long_as_it_speaks(link_config):
    """A stranger's commands move nothing, whatever they look like; nor do those of one that is silent."""
    text = StringIO()
    engine = SimulatedRobots(CONFIG, 5)
    start = engine.world.state.pose[0].copy()
    forward = WheelCommand(0.0, 6.0, 6.0, 0)
    connect = (link_config.world_at,)
    with ExitStack() as stack:
        here = stack.enter_context(Link("world", link_config, listen=link_config.world_at))
        own = stack.enter_context(Link("robot-0", link_config, connect=connect))
        stranger = stack.enter_context(Link("stranger", link_config, connect=connect))
        world = WorldProcess(
            engine, SETUP, here, Lines("world", text), speed=4.0, needs_map=False, tracker_rate=5.0
        )
        own.appear(f"alive/robot/0/{own.instance:x}")
        with running(lambda ending: world.run(10_000, ending, 0.3)):
            assert until(lambda: "robot 0 is driven by process" in text.getvalue())
            assert until(lambda: "begins without robot 0, robot 1" in text.getvalue())
            for _ in range(20):
                for robot in range(2):
                    stranger.send(f"wheels/{robot}", forward, robot)
                stranger.send_raw("wheels/0", bytes(MOST_BYTES + 1))
                stranger.send_raw("wheels/0", b"RS")
                time.sleep(0.01)
            assert until(lambda: "wheels/0: too long" in text.getvalue())
            np.testing.assert_allclose(engine.world.state.pose[0], start, atol=1e-9)
            for _ in range(20):
                own.send("wheels/0", forward, 0)
                time.sleep(0.02)
            moved = np.abs(engine.world.state.pose[0] - start).max(axis=1)
            assert moved[0] > 0.01
            assert moved[1] < 1e-9
            assert until(lambda: "robot 0 is held: its process is silent" in text.getvalue())
            held_at = engine.now
            assert until(lambda: engine.now > held_at + 1.0)
            rest = engine.world.state.pose[0].copy()
            assert until(lambda: engine.now > held_at + 1.5)
            np.testing.assert_allclose(engine.world.state.pose[0], rest, atol=1e-6)
    said = text.getvalue()
    for reason in ("wheels/0: from another process", "wheels/1: from another process", "wheels/0: too short"):
        assert reason in said


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (
            ["robot", "paper-2", "--robot", "1", "--patience", "0.2"],
            "robosim: robot 1: no world is heard, after 0.2 s; start it first.",
        ),
        (
            ["robot", "paper-2", "--robot", "2"],
            "robosim: --robot is 2, but must be a whole number from 0 to 1.",
        ),
        (
            ["world", "paper-2", "--speed", "fast"],
            'robosim: --speed is "fast", but must be a number from 0.01 to 100, or max.',
        ),
        (
            ["world", "paper-2", "--profile", "robotariun"],
            "robosim: No profile is named 'robotariun': did you mean robotarium or broad?",
        ),
        (
            ["world", "paper-2", "--view"],
            "robosim: --view shows what is recorded: it needs --save RUN.rrd.",
        ),
        (
            ["pheromones", "paper-2", "--loss", "1.5"],
            "robosim: link: loss is 1.5, but must be a number from 0 to 1.",
        ),
        (
            ["pheromones", "paper-2", "--keys", "nowhere"],
            (
                "robosim: nowhere/ca.pem: not found; the folder of keys must hold ca.pem, pheromones.pem, "
                "pheromones.key."
            ),
        ),
    ],
)
def test_wrong_usage_is_a_sentence_and_exit_code_2(command, said, capsys):
    world_at, map_at = free_addresses(2)
    assert main(["deploy", *command, "--world-at", world_at, "--map-at", map_at]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == said


def test_two_worlds_do_not_listen_at_one_address(link_config, capsys):
    with Link("world", link_config, listen=link_config.world_at):
        code = main(["deploy", "world", "paper-2", "--world-at", link_config.world_at, "--patience", "0.1"])
    assert code == 2
    assert f"robosim: the link cannot be opened at {link_config.world_at}: " in capsys.readouterr().err
