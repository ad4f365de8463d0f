"""Drive the simulator by the controller's wheel speeds alone, compare with evaluation, and time decisions.

    python tools/check_controller.py                       # all policies that ship, 300 decisions each
    python tools/check_controller.py paper-8 --decisions 2000 --alone

Prints for each policy whether all poses and pellets were those of an evaluation to the last bit, and how much
processor time of its one thread the controller takes for a control period in which it decides, and for one in
which it does not. `--alone` drives the team once more, each robot by a controller of its own that knows
everybody's pose but nobody else's gripper and contacts, and counts what both teams deliver.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import Policy, load_policy, policy_names
from robosim.deploy.controller import Controller
from robosim.deploy.readings import Readings, of_one_robot
from robosim.deploy.simulated import SimulatedRobots


def compared(policy: Policy, name: str, decisions: int, seed: int) -> tuple[bool, int, list[list[float]]]:
    """Return whether both trajectories are equal, what was delivered, and the times [kind][periods] in s."""
    chooser = LearnedController(policy, name)
    env = environment_for(chooser, world="physics", seed=seed)
    observation = env.reset()
    chooser.reset(env)
    controller, robots = Controller(policy, name=name), SimulatedRobots(env.config, env.seeds[0])
    times: list[list[float]] = [[], []]
    equal = True
    for _ in range(decisions):
        for _ in range(env.arena.timing.control_steps):
            readings = robots.readings()
            began = time.thread_time()
            command = controller.step(readings, robots.now)
            times[command.actions is None].append(time.thread_time() - began)
            robots.obey(command)
        observation = env.step(chooser.act(env, observation)).observation
        ours, theirs = robots.world.state, env.world.state
        for field in ("pose", "pellets", "held", "delivered"):
            equal &= np.array_equal(getattr(ours, field), getattr(theirs, field))
    return equal, int(env.delivered.sum()), times


def delivered_alone(policy: Policy, name: str, decisions: int, seed: int) -> int:
    """Return what a team delivers in which each robot has a controller, and no radio."""
    chooser = LearnedController(policy, name)
    env = environment_for(chooser, world="physics", seed=seed)
    robots = SimulatedRobots(env.config, env.seeds[0])
    controllers = [Controller(policy, name=name) for _ in range(env.robots)]
    for _ in range(decisions * env.arena.timing.control_steps):
        readings = robots.readings()
        commands = [
            one.step(own_readings(readings, robot), robots.now) for robot, one in enumerate(controllers)
        ]
        rows = range(env.robots)
        robots.obey(
            replace(
                commands[0],
                wheel_speeds=np.stack([commands[row].wheel_speeds[row] for row in rows]),
                gripper=np.stack([commands[row].gripper[row] for row in rows]),
            )
        )
    return int(robots.world.state.delivered[0])


def own_readings(readings: Readings, robot: int) -> Readings:
    place = readings.pellet[robot]
    return of_one_robot(
        robot,
        readings.time,
        readings.pose,
        laden=bool(readings.laden[robot]),
        at_pellet=bool(readings.at_pellet[robot]),
        touched=(
            bool(readings.touched[0, robot]),
            bool(readings.touched[1, robot]),
            bool(readings.touched[2, robot]),
        ),
        pellet=(float(place[0]), float(place[1])) if np.isfinite(place).all() else None,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policies", nargs="*", help="names or folders; by default all that ship")
    parser.add_argument("--decisions", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--alone", action="store_true", help="also each robot by a controller of its own")
    options = parser.parse_args()
    print("policy          trajectories   pellets   deciding p50, p99   else p50, p99   period")
    failed = 0
    for name in options.policies or policy_names():
        policy = load_policy(name)
        equal, delivered, times = compared(policy, name, options.decisions, options.seed)
        failed += not equal
        deciding, driving = (np.percentile(1e3 * np.array(kind), (50, 99)) for kind in times)
        period = 1e3 * policy.card.arena.timing.decision_period
        print(
            f"{name:<16}{'equal' if equal else 'DIFFER':<12}{delivered:10d}"
            f"{deciding[0]:11.2f}, {deciding[1]:.2f} ms{driving[0]:8.2f}, {driving[1]:.2f} ms"
            f"{period:7.0f} ms",
            flush=True,
        )
        if options.alone:
            alone = delivered_alone(policy, name, options.decisions, options.seed)
            print(f"{'':<16}each robot by itself, without radio: {alone} pellets", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
