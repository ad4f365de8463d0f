"""The Robotarium's own library is not ours to ship: a stand-in of what is called of it is written here."""

import ast
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import load_arena
from robosim.arena.model import Zone
from robosim.cli.main import main
from robosim.control.card import card_for
from robosim.control.network import NetworkSpec
from robosim.control.policy import find_policy, load_policy, save_policy
from robosim.deploy import Controller, Readings
from robosim.deploy.robotarium.bundle import flat_files
from robosim.deploy.robotarium.experiment import LEAST_APART, TURN, Experiment
from robosim.deploy.robotarium.export import robotarium_files
from robosim.deploy.robotarium.floor import AHEAD, NEAR, VirtualFloor, checked_distances
from robosim.envs.vector import VectorEnv
from robosim.robot.kinematics import wheel_speeds_for
from robosim.world.state import ABSENT, HELD, LOOSE, ContactKind, Gripper
from tests.deploy.made import TRAINING, random_weights

STEM = "robosim_deploy_robotarium_"


def exported(folder, policy="robotarium-4", **options):
    folder.mkdir()
    for name, data in robotarium_files(find_policy(policy), **options).items():
        (folder / name).write_bytes(data)
    return folder


def made(folder, robots=3, arena="robotarium", env=None, **network):
    """Write a policy with random weights for the Robotarium's floor."""
    env = VectorEnv(arena, robots=robots, **(env or {}))
    spec = NetworkSpec(inputs=env.layout.size, hidden=(24, 16), actions=env.num_actions, **network)
    weights = random_weights(spec, seed=1)
    save_policy(folder, weights, card_for(env, spec, weights, "made up", TRAINING))
    return folder


def random_readings(arena, robots, count, seed=0):
    """Readings of robots that wander all over the map, walls too, and of sensors that say anything."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(scale=(0.03, 0.03, 0.4), size=(count, robots, 3))
    size = np.array([*arena.size, np.inf])
    pose = np.array([*arena.size, 0.0]) * rng.random((robots, 3)) + steps.cumsum(axis=0)
    pose[..., :2] = np.abs((pose[..., :2] + size[:2]) % (2 * size[:2]) - size[:2]) * 0.999
    pellet = pose[..., :2] + rng.normal(scale=0.2, size=(count, robots, 2))
    pellet[rng.random((count, robots)) < 0.2] = np.nan
    return {
        "time": np.broadcast_to(0.1 * np.arange(count)[:, None], (count, robots)).copy(),
        "pose": pose,
        "laden": np.repeat(rng.random((count // 30 + 1, robots)) < 0.5, 30, axis=0)[:count],
        "at_pellet": rng.random((count, robots)) < 0.3,
        "touched": rng.random((count, 3, robots)) < 0.3,
        "pellet": pellet,
    }


DRIVE = f"""
import sys
before = set(sys.modules)  # some systems' Python loads a module of its own as it starts
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
sys.path.insert(0, str(folder))
from {STEM}experiment import Team
from robosim_deploy_readings import Readings
team = Team(folder).driven
columns = dict(np.load(sys.argv[2]))
speeds, actions, grippers = [], [], []
for row in range(len(columns["pose"])):
    readings = Readings(**{{name: column[row] for name, column in columns.items()}})
    here = team.on_map(readings.pose)
    team.place(readings.pose, here)
    if row % 3 == 0:
        team.decide(readings, ~here, row // 3, anew=row == 0)
    speeds.append(team.wheel_speeds(~here))
    actions.append(team.actions)
    grippers.append(team.gripper)
np.savez(sys.argv[3], speeds=speeds, actions=actions, grippers=grippers)
for name, module in sys.modules.items():
    if name not in before:
        print(name, getattr(module, "__file__", None) or "")
"""


@pytest.mark.parametrize(
    ("periods", "kind"),
    [
        (2001, None),
        (150, {"env": {"actions": "wheels"}, "of_robot": (0, 1, 2), "mask": True}),
        (150, {"env": {"actions": "wheels-9"}, "of_robot": (1, 0, 1), "normalisation": "layer"}),
        (150, {"env": {"encoding": "paper"}, "of_robot": (0, 0, 0), "precision": "float16"}),
        (150, {"env": {"keep_distance": 0.3}, "of_robot": (0, 0, 0)}),
        (150, {"env": {"stigmergy": False}, "of_robot": (0, 0, 0)}),
    ],
)
def test_a_folder_drives_to_the_bit_as_the_controller_does_on_numpy_alone(tmp_path, periods, kind):
    policy = "robotarium-4" if kind is None else str(made(tmp_path / "policy", **kind))
    folder = exported(tmp_path / "folder", policy)
    controller = Controller(load_policy(policy))
    columns = random_readings(controller.arena, controller.robots, periods)
    np.savez(tmp_path / "readings.npz", **columns)
    command = [sys.executable, "-I", "-c", DRIVE, *(folder, tmp_path / "readings.npz", tmp_path / "out.npz")]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100, cwd=tmp_path)
    out = np.load(tmp_path / "out.npz")
    told = []
    for row in range(periods):
        readings = Readings(**{name: column[row] for name, column in columns.items()})
        told.append(controller.step(readings, readings.time[0]))
    assert_array_equal(out["speeds"], [one.wheel_speeds for one in told])
    assert_array_equal(out["grippers"], [one.gripper for one in told])
    assert_array_equal(out["actions"][::3], [one.actions for one in told[::3]])
    assert len(np.unique(out["actions"])) > 1
    # Nothing but numpy and the folder itself was loaded.
    lines = [line.partition(" ") for line in ran.stdout.splitlines()]
    tops = {name.partition(".")[0] for name, _, _ in lines} - set(sys.stdlib_module_names)
    ours = {top for top in tops if top.startswith("robosim")}
    assert ours <= {path.stem for path in folder.glob("*.py")}
    assert "robosim" not in ours
    assert all(Path(path).parent == folder for name, _, path in lines if name in ours)
    assert {top for top in tops - ours if not top.startswith("_")} == {"numpy"}


def test_the_files_are_the_modules_with_other_imports():
    def without_imports(text):
        tree = ast.parse(text, feature_version=(3, 10))
        dropped = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
        for node in ast.walk(tree):
            for field in ("body", "orelse"):
                body = getattr(node, field, None)
                if isinstance(body, list):
                    setattr(node, field, [one for one in body if one not in dropped])
        return ast.dump(tree), {alias.asname or alias.name for node in dropped for alias in node.names}

    files = flat_files("robosim.deploy.robotarium.main", "main.py")
    assert "main.py" in files
    assert len(files) > 20
    for name, text in files.items():
        origin = text.splitlines()[0].rpartition(": ")[2]
        source = Path(importlib.util.find_spec(origin).origin).read_text(encoding="utf-8")
        assert name in ("main.py", f"{origin.replace('.', '_')}.py")
        assert without_imports(text) == without_imports(source)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("robosim"):
                assert "." not in node.module
    # Types that nobody imports as the code runs are not followed.
    assert "robosim_world_motion.py" not in files


def test_what_the_laboratory_lacks_cannot_be_flattened():
    with pytest.raises(RuntimeError, match=r"robosim\.arena\.shipped|pydantic_core|robosim\.arena is not"):
        flat_files("robosim.arena.schema", "main.py")


def test_the_map_lies_in_the_middle_of_the_floor_and_robots_begin_apart(tmp_path):
    experiment = Experiment(exported(tmp_path / "folder", seed=3))
    arena = load_arena("robotarium")
    x, y, heading = experiment.starts
    assert (np.abs(x) < 1.6).all()
    assert (np.abs(y) < 1.0).all()
    # The border of walls, a cell wide, lies around the floor.
    assert experiment.origin == pytest.approx([-1.8, -1.2, 0.0])
    on_map = experiment.starts.T - experiment.origin
    from_places = np.linalg.norm(on_map[:, None, :2] - arena.start_places, axis=-1)
    assert from_places.min(axis=1) == pytest.approx(0.0, abs=1e-12)
    apart = checked_distances(experiment.starts.T)
    assert apart.min() >= 0.4
    assert (heading == 0.0).all()
    assert experiment.turns == 27_273


def test_equal_policies_give_equal_bytes_and_a_seed_other_starts():
    one, same, other = (
        robotarium_files(find_policy("robotarium-4"), "robotarium-4", seed=seed) for seed in (0, 0, 1)
    )
    assert one == same
    assert [name for name in one if one[name] != other[name]] == ["team.json"]
    card = json.loads(one["team.json"])
    assert (card["policy"], card["robots"], card["apart"]) == ("robotarium-4", 4, 0.0)


def test_pellets_are_taken_carried_delivered_and_replaced_but_never_lost():
    arena = load_arena("robotarium")
    floor = VirtualFloor(arena, 3, seed=0)
    rng = np.random.default_rng(1)
    zones = arena.zones
    reach = arena.pellets.radius + arena.robot.gripper_reach
    delivered = taken = 0
    for _ in range(400):
        # From source to home and back, at random places and headings.
        zone = rng.choice([Zone.HOME, Zone.SOURCE, Zone.FLOOR])
        rows, columns = np.nonzero(zones == zone)
        cell = rng.integers(len(rows), size=3)
        place = (np.column_stack([columns[cell], rows[cell]]) + rng.random((3, 2))) * arena.cell_size
        pose = np.column_stack([place, rng.uniform(-np.pi, np.pi, 3)])
        floor.look(pose)
        before, score, lay = floor.held.copy(), floor.delivered.sum(), floor.pellets.copy()
        gripper = rng.choice([Gripper.OPEN, Gripper.KEEP, Gripper.TAKE], size=3).astype(np.int8)
        floor.act(pose, gripper)
        nose = place + 0.055 * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
        for robot in range(3):
            if before[robot] < 0 <= floor.held[robot]:
                taken += 1
                assert gripper[robot] == Gripper.TAKE
            if floor.held[robot] < 0 <= before[robot]:
                assert gripper[robot] == Gripper.OPEN
            if gripper[robot] == Gripper.KEEP:
                assert floor.held[robot] == before[robot]
            if before[robot] < 0 <= floor.held[robot] and floor.status[floor.held[robot]] == HELD:
                # What lay there before, unless it was only just put there.
                pellet = floor.held[robot]
                moved = lay[pellet] != floor.pellets[pellet]
                near = np.hypot(*(lay[pellet] - nose[robot])) <= reach + 1e-9
                assert near or moved.any()
        delivered += int(floor.delivered.sum() - score)
        held = floor.held[floor.held >= 0]
        assert len(set(held)) == len(held)
        assert (floor.status[held] == HELD).all()
        assert (floor.status == HELD).sum() == len(held)
        assert floor.pellets[held] == pytest.approx(
            (nose + (nose - place) * (0.02 / 0.055))[floor.held >= 0], abs=1e-12
        )
        home = zones[tuple((floor.pellets / arena.cell_size).astype(int)[:, ::-1].T)] == Zone.HOME
        assert not (home & (floor.status == LOOSE)).any()
    assert delivered > 10
    assert taken >= delivered
    assert (floor.status == ABSENT).sum() == 0


@pytest.mark.parametrize("apart", [0.0, 0.15])
def test_touches_are_those_of_the_bodies_and_stay_until_the_next_decision(apart):
    arena = load_arena("robotarium")
    floor = VirtualFloor(arena, 4, seed=0, apart=apart)
    rng = np.random.default_rng(2)
    floor.held[0], floor.status[7] = 7, HELD
    seen = np.zeros((3, 4), bool)
    for turn in range(200):
        if turn % 5 == 0:
            floor.begin()
            seen[:] = False
        pose = np.column_stack([rng.uniform(0.3, 0.7, 4), rng.uniform(0.3, 0.7, 4), rng.uniform(-3, 3, 4)])
        pose[rng.integers(4), 0] = rng.uniform(2.9, 3.4)
        floor.look(pose)
        along = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
        parts = [(robot, *pose[robot, :2], 0.055) for robot in range(4)]
        parts.append((0, *(pose[0, :2] + 0.075 * along[0]), 0.02))
        for one, x, y, size in parts:
            for other, x2, y2, size2 in parts:
                if one != other and np.hypot(x - x2, y - y2) <= size + size2 + NEAR:
                    seen[ContactKind.ROBOT_ROBOT, one] = True
        for one in range(4):
            for other in range(4):
                ahead = pose[:, :2] + AHEAD * along
                if apart and one != other and np.hypot(*(ahead[one] - ahead[other])) <= apart + 0.015:
                    seen[ContactKind.ROBOT_ROBOT, one] = True
            x, y = pose[one, :2]
            for x0, y0, x1, y1 in arena.walls:
                gap = np.hypot(max(x0 - x, 0.0, x - x1), max(y0 - y, 0.0, y - y1))
                seen[ContactKind.ROBOT_WALL, one] |= gap <= 0.055 + NEAR
            for pellet, (px, py) in enumerate(floor.pellets):
                close = np.hypot(px - x, py - y) <= 0.055 + 0.02
                seen[ContactKind.ROBOT_PELLET, one] |= close and floor.status[pellet] == LOOSE
        readings = floor.readings(pose, 0.0)
        assert_array_equal(readings.touched, seen)
        assert readings.laden.tolist() == [True, False, False, False]


def moved(poses, velocities):
    """Poses [3, robots] of perfect unicycles a turn later."""
    speed, rate = velocities
    return poses + TURN * np.stack([speed * np.cos(poses[2]), speed * np.sin(poses[2]), rate])


def test_velocities_keep_to_the_wheels_limits(tmp_path):
    experiment = Experiment(exported(tmp_path / "folder"))
    sheet = experiment.team.arena.robot
    rng = np.random.default_rng(4)
    experiment.step(experiment.starts)
    for _ in range(100):
        wild = np.stack([rng.uniform(-0.4, 0.4, 4), rng.uniform(-8.0, 8.0, 4)])
        kept = experiment.limited(wild)
        assert (np.abs(wheel_speeds_for(sheet, *kept)) <= sheet.max_wheel_speed).all()
        # What is slowed moves in the same direction.
        assert kept[1] * wild[0] == pytest.approx(wild[1] * kept[0])
        gentle = 0.2 * wild
        assert_array_equal(experiment.limited(gentle), gentle)


def test_nobody_drives_into_a_wall(tmp_path):
    """Whoever turns at random, and drives on at top speed, comes to many."""
    arena = load_arena("robotarium")
    floor = VirtualFloor(arena, 4, seed=0)
    rng = np.random.default_rng(4)
    pose = np.column_stack([rng.uniform(0.3, 0.7, 4), rng.uniform(0.4, 2.0, 4), rng.uniform(-3, 3, 4)])
    stopped = 0
    for _ in range(400):
        speed = np.full(4, 0.2)
        at_wall = floor.stopped_by_walls(pose, speed, TURN)
        stopped += int(at_wall.sum())
        speed[at_wall] = 0.0
        pose = moved(pose.T, np.stack([speed, rng.uniform(-3.0, 3.0, 4)])).T
        assert (floor.clearance(pose[:, :2]) >= arena.robot.outer_radius - 1e-12).all()
    assert stopped > 20
    # Away from a wall, everybody may.
    assert not floor.stopped_by_walls(np.array([[0.25, 1.0, 0.0]] * 4), np.full(4, 0.2), TURN).any()


def test_robots_that_are_to_be_kept_apart_never_come_nearer_than_allowed(tmp_path):
    """Whoever drives them: here they are all drawn to one place."""
    experiment = Experiment(exported(tmp_path / "folder", apart=0.15))
    loose = Experiment(exported(tmp_path / "loose"))
    rng = np.random.default_rng(5)
    poses = experiment.starts.copy()
    free = poses.copy()
    for _ in range(400):
        velocities = []
        for one, at in ((experiment, poses), (loose, free)):
            toward = np.arctan2(-at[1], -1.2 - at[0]) - at[2]
            wish = np.stack([np.full(4, 0.15), 3.0 * np.sin(toward) + rng.normal(size=4)])
            one.step(at)
            velocities.append(one.limited(wish))
        poses, free = moved(poses, velocities[0]), moved(free, velocities[1])
        assert checked_distances(poses.T).min() > LEAST_APART
    assert checked_distances(poses.T).min() < 0.15
    assert checked_distances(free.T).min() < LEAST_APART


def test_a_robot_that_is_not_seen_stands_still_and_the_others_go_on(tmp_path):
    experiment = Experiment(exported(tmp_path / "folder"))
    poses = experiment.starts.copy()
    driven = np.zeros(4)
    for turn in range(120):
        seen = poses.copy()
        if turn >= 20:
            seen[:, 1] = np.nan
        velocities = experiment.limited(experiment.step(seen))
        assert np.isfinite(velocities).all()
        if turn >= 20:
            assert (velocities[:, 1] == 0.0).all()
        driven += np.abs(velocities).sum(axis=0)
        poses = moved(poses, velocities)
    assert (driven[[0, 2, 3]] > 1.0).all()


STAND_IN = '''
import numpy as np
from matplotlib.figure import Figure

class Robotarium:
    """Perfect unicycles, and the laboratory's rules of what is called when."""

    def __init__(self, number_of_robots, show_figure, sim_in_real_time, initial_conditions):
        assert initial_conditions.shape == (3, number_of_robots)
        self.poses, self.told, self.asked, self.ended = initial_conditions.copy(), None, False, False
        self.AXES = Figure().subplots()
        self.AXES.set_xlim(-1.65, 1.65)
        self.AXES.set_ylim(-1.05, 1.05)

    def get_poses(self):
        assert not self.asked, "poses are to be had once in a turn"
        self.asked = True
        return self.poses.copy()

    def set_velocities(self, ids, velocities):
        assert ids.tolist() == list(range(self.poses.shape[1]))
        left = (velocities[0] - 0.055 * velocities[1]) / 0.016
        right = (velocities[0] + 0.055 * velocities[1]) / 0.016
        assert max(np.abs(left).max(), np.abs(right).max()) <= 12.5
        self.told = velocities

    def step(self):
        assert self.asked
        self.asked = False
        speed, rate = self.told
        self.poses[0] += 0.033 * speed * np.cos(self.poses[2])
        self.poses[1] += 0.033 * speed * np.sin(self.poses[2])
        self.poses[2] += 0.033 * rate
        assert (np.abs(self.poses[0]) <= 1.6).all() and (np.abs(self.poses[1]) <= 1.0).all()

    def END(self):
        assert len(self.AXES.images) == 2
        assert self.AXES.texts[0].get_text().endswith(" pellets")
        assert self.AXES.images[0].get_array().max() > 0.2
        assert self.AXES.get_xlim() == (-1.65, 1.65)
        self.AXES.figure.savefig("end.png")
        print("ended")
'''


@pytest.mark.parametrize(("axes", "end"), [("_axes_handle", "debug"), ("axes", "call_at_scripts_end")])
def test_the_script_keeps_the_rules_of_the_laboratory_and_brings_pellets(tmp_path, axes, end):
    """With the names that its simulator has had since version 2, and before."""
    pytest.importorskip("matplotlib")
    folder = exported(tmp_path / "folder", seconds=36.0)
    package = tmp_path / "library" / "rps"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "robotarium.py").write_text(STAND_IN.replace("AXES", axes).replace("END", end))
    run = "import sys, runpy; sys.path[:0] = sys.argv[1:]; runpy.run_path('main.py', run_name='__main__')"
    command = [sys.executable, "-I", "-c", run, str(folder), str(package.parent)]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=100, check=False)
    assert ran.returncode == 0, ran.stderr
    result = json.loads((folder / "result.json").read_text())
    assert result["delivered"] >= 1
    assert result["delivered"] == sum(result["delivered_of_robot"]) == result["deliveries"][-1][1]
    assert result["seconds"] == pytest.approx(36.0, abs=TURN)
    poses = np.load(folder / "poses.npy")
    assert poses.shape == (1091, 3, 4)
    assert ran.stdout.splitlines()[-1] == "ended"


@pytest.mark.slow
def test_the_laboratorys_own_simulator_finds_no_error(tmp_path):
    pytest.importorskip("rps.robotarium")
    folder = exported(tmp_path / "folder", seconds=60.0, apart=0.15)
    settings = json.loads((folder / "team.json").read_text())
    settings |= {"show_figure": False, "sim_in_real_time": False}
    (folder / "team.json").write_text(json.dumps(settings))
    ran = subprocess.run(
        [sys.executable, "main.py"], capture_output=True, text=True, cwd=folder, timeout=500, check=True
    )
    assert "No errors or warnings in your simulation" in ran.stdout
    result = json.loads((folder / "result.json").read_text())
    assert result["delivered"] >= 3
    assert result["closest"] > LEAST_APART


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["paper-8"],
            (
                "policy paper-8 needs 3.60 x 0.90 m between its walls (arena 'paper'), but the Robotarium's "
                "floor is 3.2 x 2 m."
            ),
        ),
        (
            ["three-wide-4"],
            "policy three-wide-4 drives robots of shape capsule, but the Robotarium's have circle.",
        ),
        (["robotarium-4", "--seconds", "901"], "seconds is 901, but must be from 0.033 to 900."),
        (["robotarium-4", "--seconds", "nan"], "seconds is nan, but must be from 0.033 to 900."),
        (
            ["robotarium-4", "--barrier", "0.1"],
            "barrier is 0.1, but must be from 0.135 to 0.3 (m), or 0 for none.",
        ),
        (
            ["robotarium-4", "--seed", "-1"],
            f"--seed is -1, but must be a whole number from 0 to {2**63 - 1}.",
        ),
        (["lanes"], "'lanes' is a scripted controller: it has no networks to export."),
    ],
)
def test_what_the_laboratory_would_not_take_is_refused_in_a_sentence(
    tmp_path, monkeypatch, capsys, arguments, sentence
):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *arguments, "--robotarium", "folder"]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"robots": 21, "of_robot": (0,) * 21}, "policy made drives 21 robots, but the Robotarium has 20."),
        (
            {"timing": "decision_period = 0.24\ncontrol_period = 0.08\n"},
            (
                "policy made has a control period of 0.08 s, but it must be within 5% of a whole number of "
                "the Robotarium's turns of 0.033 s."
            ),
        ),
    ],
)
def test_so_are_too_many_robots_and_periods_that_are_no_turns(tmp_path, capsys, change, sentence):
    text = load_arena("robotarium").text + "\n[timing]\n" + change.pop("timing", "")
    made(tmp_path / "made", arena=text, **{"of_robot": (0, 0, 0), **change})
    assert main(["export", str(tmp_path / "made"), "--robotarium", str(tmp_path / "folder")]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"
    assert not (tmp_path / "folder").exists()


def test_the_command_writes_a_folder_once(tmp_path, capsys):
    folder = tmp_path / "team"
    folder.mkdir()
    command = ["export", "robotarium-4", "--robotarium", str(folder), "--seconds", "60"]
    assert main(command) == 0
    said = capsys.readouterr().out
    names = {path.name for path in folder.iterdir()}
    assert said.startswith(f"{folder}: {len(names)} files, ")
    assert {"main.py", "team.json", "team.npz"} <= names
    assert all(path.is_file() for path in folder.iterdir())
    settings = json.loads((folder / "team.json").read_text())
    assert (settings["seconds"], settings["apart"]) == (60.0, 0.15)
    assert main(command) == 2
    assert capsys.readouterr().err == (
        f"robosim: {folder}: this folder is not empty; a script needs a new one.\n"
    )
    assert {path.name for path in folder.iterdir()} == names
    assert list(tmp_path.iterdir()) == [folder]
