"""Try a team of processes for real: what it brings, and what becomes of it when things go wrong.

    python tools/show_decentralised.py compare --policies paper-8 paper-8-smadrl --decisions 1000 --speed 2
    python tools/show_decentralised.py faults --policy paper-8 --decisions 200 --speed 2
    python tools/show_decentralised.py faults --only keys garbage

`compare` drives the same episodes by one process, and by a process a robot. `faults` starts a team for each
fault and prints what became of it, with a line for each thing that must hold; exit code 1 if one does not.
Logs of all processes are kept in --logs. It takes real time: 200 decisions at speed 2 are half a minute.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import re
import secrets
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import zenoh
from make_link_keys import make_keys

from robosim.control.policy import load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.link.access import tls
from robosim.deploy.link.messages import MOST_BYTES, VERSION, Order, WheelCommand, pack
from robosim.deploy.processes.launch import PHEROMONES, WORLD, TeamOfProcesses
from robosim.deploy.simulated import SimulatedRobots

TIMEOUT = 600.0
Held = list[tuple[bool, str]]
Result = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Options:
    policy: str
    robots: int
    decisions: int
    speed: str
    seed: int
    logs: Path

    def team(self, name: str, *options: str) -> TeamOfProcesses:
        folder = self.logs / name
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        return TeamOfProcesses(self.policy, self.robots, folder, options)

    def world(self, folder: Path, speed: str | None = None, decisions: int | None = None) -> list[str]:
        return [
            *("--speed", speed or self.speed, "--decisions", str(decisions or self.decisions)),
            *("--seed", str(self.seed), "--json", str(folder / "world.json")),
        ]


def one_process(policy: str, robots: int, decisions: int, seed: int) -> tuple[int, str]:
    """Return pellets and trajectory of a team that one controller drives, in the same world."""
    controller = Controller(load_policy(policy), robots, name=policy)
    config = controller.config.changed(pellet_gradient=0.0, profile=None, episode_steps=0)
    world = SimulatedRobots(config, seed)
    trajectory = hashlib.sha256()
    for _ in range(decisions):
        for _ in range(controller.arena.timing.control_steps):
            world.obey(controller.step(world.readings(), world.now))
        trajectory.update(world.world.state.pose[0].tobytes())
    return int(world.world.state.delivered[0]), trajectory.hexdigest()


def result(team: TeamOfProcesses) -> Result:
    if team.wait(WORLD, TIMEOUT):
        raise RuntimeError(f"the world failed: {team.log(WORLD)}")
    for name in list(team.running):
        team.wait(name, 30.0)
    got: Result = json.loads((team.folder / "world.json").read_text())
    return got


def begun(team: TeamOfProcesses) -> None:
    if not team.wait_for(WORLD, "all are there", 120.0):
        raise RuntimeError(f"the team did not come together: {team.log(WORLD)}")


def count(team: TeamOfProcesses, reason: str) -> int:
    """Return how many messages all processes have dropped in all for a reason."""
    found = re.findall(rf"dropped in all: (\d+) on \S+: {reason}", "\n".join(team.lines()))
    return sum(map(int, found))


def moments(text: str, pattern: str) -> list[float]:
    """Return when lines that hold `pattern` were said, s of the day."""
    said = []
    for line in text.splitlines():
        if re.search(pattern, line):
            at = datetime.strptime(line.split()[0], "%H:%M:%S.%f")
            said.append(at.hour * 3600 + at.minute * 60 + at.second + at.microsecond / 1e6)
    return said


def now() -> float:
    return time.time() % 86_400.0


def after(text: str, pattern: str, moment: float) -> float:
    """Return how long after a moment a line was said first, s; nan if it was not."""
    later = [at - moment for at in moments(text, pattern) if at >= moment - 0.005]
    return min(later, default=float("nan"))


def no_tracebacks(team: TeamOfProcesses) -> tuple[bool, str]:
    bad = [line for line in team.lines() if "Traceback" in line or "failed:" in line or "panicked" in line]
    return not bad, f"nothing crashed{': ' + bad[0] if bad else ''}"


def lost_messages(team: TeamOfProcesses) -> int:
    """Return how many messages robots and service were sent and did not get."""
    said = "\n".join(team.lines())
    return sum(int(n) for pair in re.findall(r"(\d+) messages lost|(\d+) got lost", said) for n in pair if n)


def same_trajectory(team: TeamOfProcesses, got: Result, trajectory: str) -> tuple[bool, str]:
    """Return whether the run was that of one process; not to be expected where messages were lost."""
    lost = lost_messages(team) + got["lost"]
    if got["trajectory"] != trajectory and lost:
        return True, f"(the trajectory is another one: the busy machine has lost {lost} messages)"
    return got["trajectory"] == trajectory, "the trajectory is that of one process to the last bit"


def undisturbed(options: Options) -> Held:
    team = options.team("undisturbed")
    with team:
        team.start_all(options.world(team.folder))
        got = result(team)
    served = team.log(PHEROMONES).splitlines()
    print(f"  {sum(got['delivered'])} pellets in {got['wall']:.1f} s; {served[-1].split(': ', 1)[1]}")
    stops = sum("stopped:" in line for line in team.lines())
    return [no_tracebacks(team), (sum(got["stopped"]) == 0, f"nobody was held; robots stopped {stops} times")]


def robot_killed(options: Options) -> Held:
    team = options.team("robot-killed")
    with team:
        team.start_all(options.world(team.folder))
        begun(team)
        time.sleep(8.0)
        killed = now()
        team.kill("robot-3")
        time.sleep(5.0)
        again = now()
        team.start("robot-3")
        got = result(team)
    world, robot = team.log(WORLD), team.log("robot-3")
    held = after(world, "robot 3 is held", killed)
    back = after(world, "robot 3 goes on", again)
    print(
        f"  wheels held {held:.2f} s after the kill; driving again {back:.2f} s after the new start; "
        f"{sum(got['delivered'])} pellets, {got['delivered'][3]} by robot 3"
    )
    others = [got["stopped"][robot] for robot in range(options.robots) if robot != 3]
    return [
        no_tracebacks(team),
        (held < 1.0, "the killed robot stood within a second"),
        (back < 30.0 and robot.count("drives") == 2, "its new process took over"),
        (sum(others) == 0, "nobody else was held"),
    ]


def service_killed(options: Options) -> Held:
    team = options.team("service-killed")
    file = ["--file", str(team.folder / "map.npz")]
    with team:
        team.start(WORLD, options.world(team.folder))
        team.start(PHEROMONES, file)
        for robot in range(options.robots):
            team.start(f"robot-{robot}")
        begun(team)
        time.sleep(8.0)
        killed = now()
        team.kill(PHEROMONES)
        time.sleep(5.0)
        again = now()
        team.start(PHEROMONES, file)
        got = result(team)
    robots = [team.log(f"robot-{robot}") for robot in range(options.robots)]
    stopped = [after(text, "stopped: nothing read", killed) for text in robots]
    back = [after(text, "goes on", again) for text in robots]
    restored = re.search(r"found the map of decision (\d+)", team.log(PHEROMONES))
    print(
        f"  robots stopped {min(stopped):.2f} to {max(stopped):.2f} s after the kill, went on "
        f"{min(back):.2f} to {max(back):.2f} s after the new start; restored: "
        f"{restored and restored[0]}; {sum(got['delivered'])} pellets"
    )
    return [
        no_tracebacks(team),
        (restored is not None and int(restored[1]) > 0, "the map was restored"),
        (all(one < 4.0 for one in stopped), "all robots stopped while there was no map"),
        (all(one < 30.0 for one in back), "all went on with the restored map"),
    ]


def bad_link(name: str, *disturbance: str) -> Callable[[Options], Held]:
    def try_it(options: Options) -> Held:
        team = options.team(name, *disturbance)
        with team:
            team.start_all(options.world(team.folder))
            got = result(team)
        lost = lost_messages(team)
        stops = sum("stopped:" in line for line in team.lines())
        print(
            f"  {' '.join(disturbance)}: {sum(got['delivered'])} pellets; robots missed {lost} messages; "
            f"dropped as sent twice {count(team, 'sent twice')}, as overtaken {count(team, 'overtaken')}; "
            f"{sum(got['stopped'])} control periods held, robots stopped {stops} times"
        )
        return [no_tracebacks(team), (got["decisions"] == options.decisions, "the run went on to its end")]

    return try_it


def two_of_one_name(options: Options) -> Held:
    team = options.team("two-of-one-name")
    with team:
        team.start_all(options.world(team.folder))
        begun(team)
        time.sleep(3.0)
        first = team.running["robot-3"]
        second = team.start("robot-3")
        began = time.monotonic()
        code = second.wait(60.0)
        took = time.monotonic() - began
        team.running["robot-3"] = first
        got = result(team)
    told = [line for line in team.log("robot-3").splitlines() if "another process drives" in line]
    print(f"  the second ended after {took:.1f} s with code {code}: {told}; {sum(got['delivered'])} pellets")
    return [
        no_tracebacks(team),
        (code == 2 and len(told) == 1, "the second process refused to start, and said why"),
        ("another process calls itself robot 3" in team.log(WORLD), "the world said so, too"),
        (sum(got["stopped"]) == 0, "nobody was held"),
    ]


def garbage(options: Options) -> Held:
    """At the pace of the answers, where a run without faults is the same to the last bit."""
    decisions = min(options.decisions, 100)
    pellets, trajectory = one_process(options.policy, options.robots, decisions, options.seed)
    team = options.team("garbage")
    with team:
        team.start_all(options.world(team.folder, "max", decisions))
        begun(team)
        sent = pester(team, lambda: team.running[WORLD].poll() is None)
        got = result(team)
    wrong: dict[str, int] = {}
    for line in team.lines():
        found = re.search(r"dropped in all: (\d+) on \S+: (.+)", line)
        if found:
            wrong[found[2]] = wrong.get(found[2], 0) + int(found[1])
    print(f"  a stranger sent {sent} messages; dropped, for each reason: {wrong}")
    print(f"  {sum(got['delivered'])} pellets, {pellets} undisturbed")
    return [
        no_tracebacks(team),
        (wrong.get("from another process", 0) > 0, "its wheel commands were dropped"),
        (
            wrong.get("too long", 0) > 0 and wrong.get("not a message of robosim", 0) > 0,
            "so was what is malformed",
        ),
        same_trajectory(team, got, trajectory),
    ]


def pester(team: TeamOfProcesses, goes_on: Callable[[], bool]) -> int:
    """Send everything that is wrong on every key, for as long as the run lasts; return how many."""
    sent, rng = 0, secrets.SystemRandom()
    forward = WheelCommand(1.0, 12.0, 12.0, 1)
    with open_session(addresses(team)) as session:
        time.sleep(1.0)
        while goes_on():
            robot = rng.randrange(team.robots)
            command = pack(forward, robot, secrets.randbits(63) | 1, 2**31, time.monotonic())
            for data in (
                command,
                command[:-1],
                b"",
                secrets.token_bytes(rng.randrange(1, 400)),
                command[:2] + struct.pack("<B", VERSION + 1) + command[3:],
                command[:2] + struct.pack("<BB", VERSION, 99) + command[4:],
                bytes(MOST_BYTES + 1) if sent % 400 == 0 else b"RS",
            ):
                for key in (
                    f"wheels/{robot}",
                    f"deposit/{robot}",
                    f"pose/{robot}",
                    f"reading/{robot}",
                    "clock",
                ):
                    session.put(f"robosim/team/{key}", data)
                    sent += 1
            session.put("robosim/team/wheels/99", command)
            session.put("robosim/team/wheels/x/y", command)
            time.sleep(0.05)
    return sent


def addresses(team: TeamOfProcesses) -> list[str]:
    return [team.common[team.common.index(name) + 1] for name in ("--world-at", "--map-at")]


def open_session(places: list[str], certificates: dict[str, Any] | None = None) -> zenoh.Session:
    """Open a session that keeps to no rules of its own."""
    settings = zenoh.Config()
    protocol = "tcp" if certificates is None else "tls"
    table = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [],
        "connect/endpoints": [f"{protocol}/{place}" for place in places],
        "connect/timeout_ms": 3000,
        "connect/exit_on_failure": False,
    }
    if certificates:
        table["transport/link/tls"] = certificates
    for key, value in table.items():
        settings.insert_json5(key, json.dumps(value))
    return zenoh.open(settings)


def world_killed(options: Options) -> Held:
    team = options.team("world-killed")
    with team:
        team.start_all(options.world(team.folder))
        begun(team)
        time.sleep(6.0)
        killed = now()
        team.kill(WORLD)
        time.sleep(3.0)
        robots = [team.log(f"robot-{robot}") for robot in range(options.robots)]
        stopped = [after(text, "stopped: pose of", killed) for text in robots]
        again = now()
        team.start(WORLD, options.world(team.folder))
        got = result(team)
    served = "another run of the world: begins with an empty map" in team.log(PHEROMONES)
    robots = [team.log(f"robot-{robot}") for robot in range(options.robots)]
    back = [after(text, "goes on", again) for text in robots]
    print(
        f"  robots stopped {min(stopped):.2f} to {max(stopped):.2f} s after the kill, and drove "
        f"{min(back):.2f} to {max(back):.2f} s after another world was started; "
        f"{sum(got['delivered'])} pellets in it"
    )
    return [
        no_tracebacks(team),
        (all(one < 1.5 for one in stopped), "all robots stopped"),
        (all(one < 60.0 for one in back) and served, "all began anew with the new world, and so did the map"),
    ]


def keys(options: Options) -> Held:
    decisions = min(options.decisions, 60)
    _, trajectory = one_process(options.policy, options.robots, decisions, options.seed)
    with tempfile.TemporaryDirectory() as scratch:
        folder, others = Path(scratch) / "keys", Path(scratch) / "others"
        make_keys(folder, options.robots, days=1)
        make_keys(others, options.robots, days=1)
        team = options.team("keys", "--keys", str(folder))
        with team:
            team.start_all(options.world(team.folder, "max", decisions))
            begun(team)
            unsigned = {"root_ca_certificate": str(folder / "ca.pem")}
            foreign = {**tls("robot-0", others), "root_ca_certificate": str(folder / "ca.pem")}
            strangers = {
                "without a certificate": attack(team, unsigned),
                "with another authority's": attack(team, foreign),
                "robot 1, with its own": attack(team, tls("robot-1", folder)),
            }
            got = result(team)
    print(f"  hears of them, of 50 commands for robot 0 each: {strangers}")
    reached = [line for line in team.log(WORLD).splitlines() if "dropped" in line and "wheels/0" in line]
    return [
        no_tracebacks(team),
        (got["decisions"] == decisions, "the team ran with TLS and access control"),
        same_trajectory(team, got, trajectory),
        (not reached, "no command of theirs has even reached the world's process"),
        ("emergency stop" not in team.log(WORLD), "nor has an emergency stop"),
        (strangers["robot 1, with its own"] > 0, "the one with a certificate was let in, and heard poses"),
        (
            strangers["without a certificate"] == strangers["with another authority's"] == 0,
            "the others were not",
        ),
    ]


def attack(team: TeamOfProcesses, certificates: dict[str, Any]) -> int:
    """Send robot 0's wheel commands, and emergency stops; return how many poses the sender has heard."""
    heard: list[object] = []
    forward = WheelCommand(1.0, 12.0, 12.0, 1)
    with open_session(addresses(team)[:1], certificates) as session:
        session.declare_subscriber("robosim/team/pose/*", heard.append)
        for number in range(1, 51):
            session.put("robosim/team/wheels/0", pack(forward, 0, 7, number, time.monotonic()))
            session.put("robosim/team/order", pack(Order(reason="no"), 0, 7, number, time.monotonic()))
            time.sleep(0.02)
    return len(heard)


def emergency_stop(options: Options) -> Held:
    """With TLS and access control, by the operator's own certificate."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "keys"
        make_keys(folder, options.robots, days=1)
        team = options.team("emergency-stop", "--keys", str(folder))
        with team:
            team.start_all(options.world(team.folder))
            begun(team)
            time.sleep(5.0)
            asked = now()
            stop = operator(team, folder, "stop", "--reason", "a test")
            team.kill("robot-2")
            again = now()
            team.start("robot-2")
            team.wait_for("robot-2", "drives", 60.0)
            time.sleep(1.0)
            released = now()
            release = operator(team, folder, "release")
            got = result(team)
    robots = [team.log(f"robot-{robot}") for robot in range(options.robots)]
    held = [after(text, "stopped: emergency stop: a test", asked) for text in robots]
    stood = [after(text, ": stands", asked) for text in robots]
    late = after(robots[2], "stopped: emergency stop: a test", again)
    back = [after(text, "the emergency stop is released", released) for text in robots]
    print(
        f"  said by the command: {stop[1]!r}; robots held {min(held):.2f} to {max(held):.2f} s after it was "
        f"typed, were seen at rest after {min(stood):.2f} to {max(stood):.2f} s; a robot that was started "
        f"anew held {late:.2f} s later; all went on {min(back):.2f} to {max(back):.2f} s after the release; "
        f"{sum(got['delivered'])} pellets"
    )
    return [
        no_tracebacks(team),
        (stop[0] == 0 and all(one < 10.0 for one in held), "all robots held, and were seen at rest"),
        (late < 30.0, "so did one that came late"),
        (release[0] == 0 and all(one < 10.0 for one in back), "all went on after the release, none before"),
        (got["decisions"] == options.decisions, "the run went on to its end"),
    ]


def operator(team: TeamOfProcesses, folder: Path, *what: str) -> tuple[int, str]:
    """Run a command of the operator; return its exit code and what it said."""
    options = ["--world-at", addresses(team)[0], "--keys", str(folder), "--patience", "20"]
    command = [sys.executable, "-m", "robosim", "deploy", *what, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, (done.stdout + done.stderr).strip()


FAULTS: dict[str, Callable[[Options], Held]] = {
    "undisturbed": undisturbed,
    "robot-killed": robot_killed,
    "service-killed": service_killed,
    "world-killed": world_killed,
    "lost": bad_link("lost", "--loss", "0.1"),
    "doubled": bad_link("doubled", "--doubled", "0.3"),
    "late": bad_link("late", "--delay", "0.02"),
    "out-of-order": bad_link("out-of-order", "--jitter", "0.1"),
    "all-of-it": bad_link("all-of-it", "--loss", "0.1", "--doubled", "0.1", "--jitter", "0.05"),
    "two-of-one-name": two_of_one_name,
    "garbage": garbage,
    "emergency-stop": emergency_stop,
    "keys": keys,
}


def faults(options: Options, only: list[str]) -> int:
    failed = 0
    for name in only or FAULTS:
        print(f"{name}", flush=True)
        for holds, what in FAULTS[name](options):
            failed += not holds
            print(f"  {'ok' if holds else 'FAILED'}: {what}", flush=True)
    return 1 if failed else 0


def compare(options: Options, policies: list[str], seeds: list[int]) -> int:
    print("policy            seed  one process  eight and the map  ratio   wall   incomplete ticks  equal")
    ratios = []
    for policy in policies:
        robots = load_policy(policy).robots
        for seed in seeds:
            pellets, trajectory = one_process(policy, robots, options.decisions, seed)
            mine = dataclasses.replace(options, policy=policy, robots=robots, seed=seed)
            team = mine.team(f"{policy}-{seed}-{options.speed}")
            with team:
                team.start_all(mine.world(team.folder))
                got = result(team)
            ratio = sum(got["delivered"]) / max(pellets, 1)
            ratios.append(ratio)
            ticks = re.search(r"of which (\d+) lacked", team.log(PHEROMONES))
            print(
                f"{policy:<18}{seed:4d}{pellets:13d}{sum(got['delivered']):19d}{ratio:7.2f}"
                f"{got['wall']:7.0f} s{ticks[1] if ticks else '?':>17}  {got['trajectory'] == trajectory}",
                flush=True,
            )
    print(f"mean ratio {statistics.mean(ratios):.3f}")
    return 0 if statistics.mean(ratios) >= 0.9 else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("compare", "faults"))
    parser.add_argument("--policies", nargs="+", default=["paper-8", "paper-8-smadrl"], help="for compare")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], help="for compare")
    parser.add_argument("--policy", default="paper-8", help="for faults")
    parser.add_argument("--only", nargs="+", choices=FAULTS, default=[], help="for faults: only these")
    parser.add_argument("--decisions", type=int, default=200)
    parser.add_argument("--speed", default="2")
    parser.add_argument("--logs", type=Path, default=Path("decentralised"))
    chosen = parser.parse_args()
    robots = load_policy(chosen.policy).robots
    options = Options(chosen.policy, robots, chosen.decisions, chosen.speed, 0, chosen.logs)
    if chosen.what == "compare":
        return compare(options, chosen.policies, chosen.seeds)
    return faults(options, chosen.only)


if __name__ == "__main__":
    sys.exit(main())
