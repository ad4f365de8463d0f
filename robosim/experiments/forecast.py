"""How long jobs will take, by those that are done."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from robosim.experiments.results import Result

Config = Mapping[str, Any]
_Level = tuple[object, ...]


class Running(NamedTuple):
    """A job at work."""

    config: Config
    seconds: float
    """Since it was first heard of."""
    before: float
    """Share that was done then."""
    done: float
    """Share that is done now."""


class Forecast:
    """Expects of a job what those before it took that are most like it: same team, else same technique ..."""

    def __init__(self, results: Iterable[Result] = ()) -> None:
        self._learning: dict[_Level, list[float]] = defaultdict(list)
        """Seconds for a joint decision."""
        self._measuring: dict[_Level, list[float]] = defaultdict(list)
        """Seconds for an episode."""
        for result in results:
            self.add(result)

    def add(self, result: Result) -> None:
        """Take in what a job took."""
        for level in _levels(result.config):
            if steps := _steps(result.config):
                self._learning[level].append(result.wall_time / steps)
            self._measuring[level].append(result.evaluation_time / _episodes(result.config))

    def seconds(self, config: Config) -> float | None:
        """Return how long a job takes from its beginning, s; None while there is nothing to go by."""
        learning, measuring = _nearest(self._learning, config), _nearest(self._measuring, config)
        steps = _steps(config)
        if measuring is None or (steps and learning is None):
            return None
        return (learning or 0.0) * steps + measuring * _episodes(config)

    def left(self, waiting: Sequence[Config], running: Sequence[Running], workers: int) -> float | None:
        """Return how long all of them take yet, `workers` at a time, s; None with nothing to go by."""
        at_work = [self._rest(one) for one in running]
        known = [seconds for seconds in (*at_work, *map(self.seconds, waiting)) if seconds is not None]
        unknown = len(running) + len(waiting) - len(known)
        if not known:
            return None if unknown else 0.0
        total = sum(known) * (1.0 + unknown / len(known))
        return max(total / max(workers, 1), *(seconds or 0.0 for seconds in at_work), 0.0)

    def _rest(self, job: Running) -> float | None:
        """Return how long a job at work takes yet, by its own speed once that shows."""
        if job.done - job.before >= _SHOWS:
            return job.seconds * (1.0 - job.done) / (job.done - job.before)
        whole = self.seconds(job.config)
        return None if whole is None else whole * (1.0 - job.done)


_SHOWS = 0.02
"""Share of a job that shows its speed."""


def _levels(config: Config) -> Iterator[_Level]:
    """Yield what a job has in common with others, the nearest first."""
    technique, env = config["run"]["technique"], config["env"]
    yield technique, env["robots"], env["world"]
    yield technique, env["world"]
    yield (env["world"],)
    yield ()


def _nearest(times: Mapping[_Level, Sequence[float]], config: Config) -> float | None:
    """Return the mean time of the jobs most like this one."""
    for level in _levels(config):
        if found := times.get(level):
            return sum(found) / len(found)
    return None


def _steps(config: Config) -> int:
    return int(config["schedule"]["steps"]) if "schedule" in config else 0


def _episodes(config: Config) -> int:
    return int(config["evaluation"]["episodes"])
