"""Logs of controllers that drove simulated robots through trouble."""

import numpy as np

from robosim.control.policy import load_policy
from robosim.deploy import Controller, DecisionLog
from robosim.deploy.simulated import SimulatedRobots


def logged_run(path, periods=90, policy="paper-2", watch=None):
    """Drive robots: one is lost for a while, all are held, then all begin anew; return the commands.

    `watch` is called with the controller after each control period.
    """
    log = DecisionLog(path)
    controller = Controller(load_policy(policy), log=log, name=policy)
    robots = SimulatedRobots(controller.config, seed=4)
    commands = []
    for period in range(periods):
        if period == 40:
            controller.emergency_stop("a test")
        if period == 50:
            controller.resume()
        if period == 70:
            controller.reset()
        readings = robots.readings()
        if 20 <= period < 26:
            readings.pose[1] = np.nan
        commands.append(controller.step(readings, robots.now))
        robots.obey(commands[-1])
        if watch is not None:
            watch(controller)
    log.close()
    assert log.failed == ""
    return commands
