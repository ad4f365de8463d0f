"""From the simulator to robots: policies as ONNX files, and the controller that runs on a robot."""

from robosim.deploy.controller import Command, Controller
from robosim.deploy.log import DecisionLog
from robosim.deploy.readings import Readings
from robosim.discretise.reckoning import Reckoning

__all__ = ["Command", "Controller", "DecisionLog", "Readings", "Reckoning"]
