"""Show that a sweep on a Ray cluster survives the death of a node, and equals the same sweep without Ray.

    pip install '.[train,cluster]'
    python tools/show_ray_sweep.py [--steps 40000] [--jobs 6]

Starts a cluster of three nodes on this machine, a core each, and works tiny jobs off twice. In the midst one
node is killed (SIGKILL to its raylet and to its workers), the first time with the folder of its job left as
on a disk that nodes share, the second time with the folder gone, as with a disk of its own. Fails unless
every job ends well, none is recorded twice, and all numbers equal, to the last bit, those of the local
engine.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from ray.cluster_utils import Cluster

from robosim.experiments.jobs import Failure, Job
from robosim.experiments.local import LocalEngine
from robosim.experiments.ray_engine import RayEngine
from robosim.experiments.results import Result
from robosim.experiments.runner import Summary, Watch, run_jobs
from robosim.experiments.team import Measuring, learning_job, work_off
from robosim.learning.config import run_config

NODES = 3
KILL_AT = 0.4
"""Share of a job that is done when its node is killed: past its first checkpoint, at 10,000 decisions."""
LIGHT = {"world": "grid", "num_envs": 16, "updates_per_step": 0.05, "hidden": (16,)}
QUICK = {
    "health_check_initial_delay_ms": 0,
    "health_check_period_ms": 1000,
    "health_check_failure_threshold": 3,
}


class Killer(Watch):
    """Kills a node of the cluster as soon as a job on it is far enough, and says what happens."""

    def __init__(self, cluster: Cluster, root: Path, shared: bool) -> None:
        self.killed = False
        self._cluster = cluster
        self._root = root
        self._shared = shared
        self._began = time.monotonic()
        self._last: dict[str, float] = {}

    def at(self, job: Job, done: float) -> None:
        before = self._last.get(job.key, -1.0)
        self._last[job.key] = done
        if before < 0.0 or (done < before and not done):
            self._say(f"job {job.key[:8]} begins")
        elif before == 0.0 or done < before:
            self._say(f"job {job.key[:8]} is at {done:.0%}")
        if not self.killed and KILL_AT <= done < 1.0:
            self._kill(job)

    def ended(self, job: Job, outcome: Result | Failure) -> None:
        what = f"failed: {outcome.reason}" if isinstance(outcome, Failure) else "done"
        self._say(f"job {job.key[:8]} {what}")

    def _kill(self, job: Job) -> None:
        """Kill the node that a job is on, unless it is the head of the cluster."""
        for node in self._cluster.worker_nodes:
            processes = _family(node.all_processes["raylet"][0].process.pid)
            if any(_holds(process, job.folder(self._root)) for process in processes):
                self.killed = True
                for process in processes:
                    # Without their raylet, some are gone before their turn.
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(process, signal.SIGKILL)
                if not self._shared:
                    shutil.rmtree(job.folder(self._root))
                folder = "stays" if self._shared else "goes with it"
                self._say(
                    f"node {node.node_id[:8]} is killed, {len(processes)} processes, with job {job.key[:8]} "
                    f"at {self._last[job.key]:.0%}; the job's folder {folder}"
                )
                return

    def _say(self, what: str) -> None:
        print(f"{time.monotonic() - self._began:6.1f} s  {what}", flush=True)


def _family(pid: int) -> list[int]:
    """Return a process and all that it has started, and those have."""
    listed = subprocess.run(["pgrep", "--parent", str(pid)], capture_output=True, text=True, check=False)
    return [pid, *(one for child in listed.stdout.split() for one in _family(int(child)))]


def _holds(pid: int, folder: Path) -> bool:
    """Return whether a process has a folder open, as a job has its own."""
    try:
        return any(os.path.realpath(handle) == str(folder) for handle in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return False


def on_cluster(jobs: Sequence[Job], root: Path, shared: bool) -> Summary:
    """Work jobs off on three nodes, of which one dies."""
    results = root.with_suffix(".jsonl")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "_system_config": QUICK})
    try:
        for _ in range(NODES - 1):
            cluster.add_node(num_cpus=1)
        killer = Killer(cluster, root, shared)
        summary = run_jobs(jobs, work_off, root, results, RayEngine(cluster.address), killer)
    finally:
        cluster.shutdown()
    require(killer.killed, "no node was killed: the jobs were too short")
    require(not summary.failures, f"jobs failed: {[failure.reason for failure in summary.failures]}")
    lines = results.read_text().splitlines()
    require(len(lines) == len(jobs), f"{len(lines)} records of {len(jobs)} jobs")
    require(len({line.split(",")[0] for line in lines}) == len(jobs), "a job was recorded twice")
    return summary


def numbers(summary: Summary) -> list[object]:
    """Return what jobs came to, without times and machine."""
    return [(one.key, one.config, one.figures, one.series) for one in summary.results if one is not None]


def require(condition: bool, otherwise: str) -> None:
    if not condition:
        raise SystemExit(f"FAILED: {otherwise}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=40_000)
    parser.add_argument("--jobs", type=int, default=6)
    options = parser.parse_args()
    jobs = [
        learning_job(
            run_config("iql", robots=1 + seed % 2, steps=options.steps, seed=seed, **LIGHT),
            Measuring(episodes=2, steps=500),
        )
        for seed in range(options.jobs)
    ]
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(os.path.realpath(scratch))
        print(f"local engine: {len(jobs)} jobs", flush=True)
        local = run_jobs(jobs, work_off, root / "local", root / "local.jsonl", LocalEngine(2))
        require(not local.failures, "jobs failed without Ray")
        for shared in (True, False):
            print(f"Ray, three nodes, {'a shared disk' if shared else 'disks of their own'}:", flush=True)
            found = on_cluster(jobs, root / ("shared" if shared else "own"), shared)
            require(numbers(found) == numbers(local), "figures differ from those of the local engine")
            print(f"{len(jobs)} jobs, {len(jobs)} records; all numbers are those of the local engine")


if __name__ == "__main__":
    main()
