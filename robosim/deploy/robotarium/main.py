"""The experiment's main file: a team trained with robosim carries pellets through a tunnel.

All files of this folder belong to it. They need numpy, and the laboratory's own simulator, rps, which is
github.com/robotarium/robotarium_python_simulator. Constants that may be changed are in team.json.
"""

import json
from pathlib import Path

import numpy as np
import rps.robotarium as robotarium

from robosim.deploy.robotarium.experiment import Experiment
from robosim.deploy.robotarium.floor import AHEAD
from robosim.deploy.robotarium.picture import Picture

experiment = Experiment(Path(__file__).resolve().parent)
settings = experiment.team.settings
robots = experiment.robots
r = robotarium.Robotarium(
    number_of_robots=robots,
    show_figure=settings["show_figure"],
    sim_in_real_time=settings["sim_in_real_time"],
    initial_conditions=experiment.starts,
)
# By their names since version 2 of the simulator, and before.
axes = getattr(r, "_axes_handle", None) or getattr(r, "axes", None)
picture = Picture(axes, experiment) if settings["show_figure"] and axes is not None else None

safe = None
if experiment.apart:
    from rps.utilities.barrier_certificates import create_uni_barrier_certificate

    # Between the very points whose distance the laboratory checks, and stiff: by the usual gain of 100,
    # robots 0.25 m apart could approach at 1 cm/s only, and lanes of a tunnel are nearer than that.
    safe = create_uni_barrier_certificate(
        barrier_gain=1e5,
        safety_radius=experiment.apart - 2.0 * AHEAD,
        projection_distance=AHEAD,
    )

driven = np.empty((experiment.turns, 3, robots), np.float32)
for turn in range(experiment.turns):
    poses = r.get_poses()
    driven[turn] = poses
    velocities = experiment.step(poses)
    if safe is not None and experiment.crowded:
        velocities = safe(velocities, poses)
    r.set_velocities(np.arange(robots), experiment.limited(velocities))
    if picture is not None and experiment.decided:
        picture.draw()
    r.step()

result = experiment.result()
print(f"{result['delivered']} pellets in {result['seconds']:.0f} s, {result['delivered_of_robot']} by robot")
Path("result.json").write_text(json.dumps(result), encoding="utf-8")
np.save("poses.npy", driven)
end = getattr(r, "debug", None) or r.call_at_scripts_end
end()
