"""What an episode came to in numbers, each with its formula, unit and source; what has none says why.

A metric is a function of an `Episode`. Its docstring gives the formula and the source; `METRICS` lists
them in the order of a report.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.clogs.clog import TRANSITS, Clog, clogged_decisions, clogs_among
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.tails import LEAST, PowerLaw, fit_power_law
from robosim.analysis.measure.traffic import lapses, segregation
from robosim.analysis.measure.workload import gini
from robosim.discretise.modes import Mode
from robosim.world.contacts import ContactKind

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NotDefined:
    """In place of a value that a metric does not have."""

    reason: str


MetricValue = float | NotDefined
"""What a metric comes to."""

NO_TRIPS = NotDefined("no trips")
NO_TIME = NotDefined("no decisions were taken")
NO_TUNNEL = NotDefined("the arena has no tunnel")
NEVER_IN_TUNNEL = NotDefined("no robot was in a tunnel")
NO_FORCES = NotDefined("the grid world knows no forces")
NO_PUSHING = NotDefined("in the grid world pellets block nobody")
ONE_ROBOT = NotDefined("one robot has nobody to share with")
ONE_ROBOT_ALONE = NotDefined("one robot has nobody to come near to")


@dataclass(frozen=True, slots=True)
class Metric:
    """A number that describes an episode: its name, its unit, and how it is computed."""

    name: str
    unit: str
    compute: Callable[[Episode], MetricValue]

    @property
    def definition(self) -> str:
        """The formula and the source, from the docstring: what it says that the function returns."""
        words = " ".join((self.compute.__doc__ or "").split()).removeprefix("Return ")
        # A formula keeps its letter: G = ..., k = ....
        return words if words[1:2] == " " else words[:1].upper() + words[1:]


@dataclass(frozen=True, slots=True)
class Summary:
    """A metric over several episodes."""

    metric: Metric
    values: tuple[MetricValue, ...]
    """Of each episode."""

    @property
    def defined(self) -> Floats:
        """The values of the episodes in which the metric is defined."""
        return np.array([value for value in self.values if not isinstance(value, NotDefined)])

    @property
    def mean(self) -> MetricValue:
        """Mean of the episodes in which it is defined; with none, the first one's reason."""
        defined = self.defined
        if len(defined):
            return float(defined.mean())
        return self.values[0] if self.values else NotDefined("no episodes")

    @property
    def std(self) -> MetricValue:
        """Standard deviation between episodes, with n - 1."""
        defined = self.defined
        return float(defined.std(ddof=1)) if len(defined) > 1 else NotDefined("fewer than two episodes")


def pellets(episode: Episode) -> MetricValue:
    """Return sum of the robots' deliveries."""
    return float(episode.totals.delivered.sum())


def pellet_rate(episode: Episode) -> MetricValue:
    """Return pellets / decisions * 1000."""
    return NO_TIME if episode.decisions == 0 else 1000.0 * _sum(episode.totals.delivered) / episode.decisions


def workload_gini(episode: Episode) -> MetricValue:
    """Return G = 1 - 2 A, with A the area under the Lorenz curve of the pellets of each robot; Gini 1912."""
    if episode.robots == 1:
        return ONE_ROBOT
    value = gini(episode.totals.delivered)
    return NotDefined("no pellets were delivered") if value is None else value


def active_fraction(episode: Episode) -> MetricValue:
    """Return mean, over stretches of 120 s, of the share of robots that were in a tunnel; Aguilar 2018."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    active = episode.traffic.active
    return float(active.mean()) if len(active) else NotDefined("the run is shorter than 120 s")


def stop_share(episode: Episode) -> MetricValue:
    """Return share of all robots' decisions that were Stop: who stands by choice is in no clog."""
    return _share(_sum(episode.traffic.stops), episode.decisions * episode.robots, NO_TIME)


def trip_time(episode: Episode) -> MetricValue:
    """Return mean time from a robot's delivery, or the start, to its next delivery."""
    trips = episode.trips
    return NO_TRIPS if not trips else sum(sum(trip.seconds) for trip in trips) / len(trips)


def trip_share_of(mode: Mode) -> Callable[[Episode], MetricValue]:
    """Return the metric that splits the time of trips by mode."""
    name = mode.name.capitalize().replace("_", "-")

    def share(episode: Episode) -> MetricValue:
        time = np.array([trip.seconds for trip in episode.trips]).reshape(-1, len(Mode)).sum(axis=0)
        return _share(time[mode], float(time.sum()), NO_TRIPS)

    share.__doc__ = f"Return time of all trips in mode {name}, over their whole time."
    return share


def contacts_per_trip(kind: ContactKind) -> Callable[[Episode], MetricValue]:
    """Return the metric that counts touches of one kind."""
    what = {
        ContactKind.ROBOT_ROBOT: "another robot (counted for both)",
        ContactKind.ROBOT_WALL: "a wall",
        ContactKind.ROBOT_PELLET: "a loose pellet",
    }[kind]

    def touches(episode: Episode) -> MetricValue:
        if kind == ContactKind.ROBOT_PELLET and _without_forces(episode):
            return NO_PUSHING
        return _share(_sum(episode.totals.contacts[:, kind]), len(episode.trips), NO_TRIPS)

    touches.__doc__ = (
        f"Return touches of {what} that began, over trips. A touch is a series of contacts of the same two "
        "bodies with no pause longer than a decision."
    )
    return touches


def impulse_per_trip(episode: Episode) -> MetricValue:
    """Return impulse that robots pass to each other, counted for both, over trips.

    The solver's impulse of the last substep of a control period stands for all of its substeps.
    """
    if _without_forces(episode):
        return NO_FORCES
    return _share(_sum(episode.totals.impulse), len(episode.trips), NO_TRIPS)


def reversals_per_trip(episode: Episode) -> MetricValue:
    """Return visits of a tunnel that went a robot's length deep and ended where they began, over trips.

    (Reversals: Aguilar 2018.)
    """
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    length = episode.arena.robot.length
    turned = sum(visit.is_reversal(length) for visit in episode.traffic.visits)
    return _share(turned, len(episode.trips), NO_TRIPS)


def wheel_energy(episode: Episode) -> MetricValue:
    """Return energy that slip takes at the wheels of all robots.

    Force times slip distance, under Coulomb's law; what is passed on by pushing is not in it.
    """
    return NO_FORCES if _without_forces(episode) else _sum(episode.totals.energy)


def energy_per_pellet(episode: Episode) -> MetricValue:
    """Return energy that slip takes at the wheels of all robots, over pellets.

    Force times slip distance, under Coulomb's law; what is passed on by pushing is not in it.
    """
    energy = wheel_energy(episode)
    if isinstance(energy, NotDefined):
        return energy
    return _share(energy, _sum(episode.totals.delivered), NotDefined("no pellets were delivered"))


def closest_approach(episode: Episode) -> MetricValue:
    """Return least distance between the centres of two robots, at any time of the episode."""
    if episode.robots == 1:
        return ONE_ROBOT_ALONE
    closest = float(episode.totals.closest.min())
    return closest if math.isfinite(closest) else NotDefined("distances were not metered")


def passages(episode: Episode) -> MetricValue:
    """Return visits of a tunnel that came in at one end and left at the other, over the hours of the run."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    through = sum(visit.passage for visit in episode.traffic.visits)
    return _share(3600.0 * through, episode.seconds, NO_TIME)


def tunnel_density(episode: Episode) -> MetricValue:
    """Return mean over stretches of 30 s, and tunnels, of k = sum of times in it / (L T); Edie 1963."""
    return _mean_of_windows(episode, episode.traffic.windows.density)


def tunnel_flow(episode: Episode) -> MetricValue:
    """Return mean over stretches of 30 s, and tunnels, of q = sum of approaches to the goals in it / (L T).

    An approach is by how much a robot's distance to its goal falls. What it rises by counts against the flow,
    so that to and fro is none. (Edie 1963.)
    """
    return _mean_of_windows(episode, episode.traffic.windows.flow)


def mean_in_tunnel(episode: Episode) -> MetricValue:
    """Return mean number of robots in the tunnels at once."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    count = episode.traffic.robots_in_tunnel
    return _share(float((count * np.arange(len(count))).sum()), _sum(count), NO_TIME)


def most_in_tunnel(episode: Episode) -> MetricValue:
    """Return largest number of robots in the tunnels at once."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    there = np.flatnonzero(episode.traffic.robots_in_tunnel)
    return float(there[-1]) if len(there) else NO_TIME


def alone_share(episode: Episode) -> MetricValue:
    """Return time with one robot in the tunnels, over the time with any."""
    count = episode.traffic.robots_in_tunnel
    return _share(float(count[1]), _sum(count[1:]), _no_visit(episode))


def bidirectional_share(episode: Episode) -> MetricValue:
    """Return time in which laden and unladen robots move along the tunnels at once, over that with any."""
    return _share(
        float(episode.traffic.bidirectional), _sum(episode.traffic.robots_in_tunnel[1:]), _no_visit(episode)
    )


def lane_segregation(episode: Episode) -> MetricValue:
    """Return D = 1/2 sum |u_c / U - l_c / L| over cells c of the tunnels; u, l: unladen and laden traffic.

    Traffic is the time in which robots move along there. 0 when both use the same cells, 1 when each have
    their own. (Duncan and Duncan 1955.)
    """
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    value = segregation(episode.traffic)
    return NotDefined("not both laden and unladen robots moved along a tunnel") if value is None else value


def median_lapse(episode: Episode) -> MetricValue:
    """Return median time between consecutive passages of the same tunnel; Garcimartin et al. 2014."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    times = lapses(episode.traffic, episode.arena.timing.decision_period)
    return float(np.median(times)) if len(times) else NotDefined("fewer than two passages of a tunnel")


def lapse_exponent(episode: Episode) -> MetricValue:
    """Return alpha of p(t) ~ t^-alpha for the tail of the lapses, by maximum likelihood.

    At 2 and below the mean lapse has no bound. (Clauset et al. 2009; Zuriguel et al. 2014.)
    """
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    times = lapses(episode.traffic, episode.arena.timing.decision_period)
    fit: PowerLaw | None = fit_power_law(times)
    if fit is not None:
        return fit.alpha
    return NotDefined(f"a tail wants {LEAST} lapses and more, not all the same: there are {len(times)}")


def clog_count(episode: Episode) -> MetricValue:
    """Return how many clogs; see `robosim.analysis.clogs.clog` for what one is."""
    return NO_TUNNEL if episode.tunnels.count == 0 else float(len(clogs(episode)))


def clogged_share(episode: Episode) -> MetricValue:
    """Return decisions with at least one clog standing, over all."""
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    return _share(clogged_decisions(clogs(episode), episode.decisions), episode.decisions, NO_TIME)


def clog_duration(episode: Episode) -> MetricValue:
    """Return mean duration of the clogs."""
    durations = clog_durations(episode)
    return float(durations.mean()) if len(durations) else _no_clog(episode)


def longest_clog(episode: Episode) -> MetricValue:
    """Return duration of the longest clog."""
    durations = clog_durations(episode)
    return float(durations.max()) if len(durations) else _no_clog(episode)


def clogs(episode: Episode, transits: float = TRANSITS) -> list[Clog]:
    """Return the clogs of an episode: what stood longer than `transits` free-flow transit times."""
    return clogs_among(episode.standstills, transits)


def clog_durations(episode: Episode, transits: float = TRANSITS) -> Floats:
    """Return how long each clog lasted, [clogs] s."""
    period = episode.arena.timing.decision_period
    return np.array([(clog.end - clog.start) * period for clog in clogs(episode, transits)])


METRICS: list[Metric] = [
    Metric("pellets", "", pellets),
    Metric("pellets in 1000 decisions", "", pellet_rate),
    Metric("Gini coefficient of the workload", "", workload_gini),
    Metric("active fraction", "", active_fraction),
    Metric("decisions to stop", "", stop_share),
    Metric("trip time", "s", trip_time),
    *(
        Metric(f"- of it {mode.name.capitalize().replace('_', '-')}", "", trip_share_of(mode))
        for mode in Mode
    ),
    Metric("touches of robots per trip", "", contacts_per_trip(ContactKind.ROBOT_ROBOT)),
    Metric("closest approach of two robots", "m", closest_approach),
    Metric("touches of walls per trip", "", contacts_per_trip(ContactKind.ROBOT_WALL)),
    Metric("touches of pellets per trip", "", contacts_per_trip(ContactKind.ROBOT_PELLET)),
    Metric("impulse between robots per trip", "N s", impulse_per_trip),
    Metric("reversals per trip", "", reversals_per_trip),
    Metric("wheel energy per pellet", "J", energy_per_pellet),
    Metric("passages", "1/h", passages),
    Metric("tunnel density", "1/m", tunnel_density),
    Metric("tunnel flow", "1/s", tunnel_flow),
    Metric("robots in the tunnels, mean", "", mean_in_tunnel),
    Metric("robots in the tunnels, most", "", most_in_tunnel),
    Metric("one robot alone in the tunnels", "", alone_share),
    Metric("bidirectional traffic", "", bidirectional_share),
    Metric("lane segregation", "", lane_segregation),
    Metric("lapse between passages, median", "s", median_lapse),
    Metric("lapse tail exponent", "", lapse_exponent),
    Metric("clogs", "", clog_count),
    Metric("time clogged", "", clogged_share),
    Metric("clog duration, mean", "s", clog_duration),
    Metric("clog duration, longest", "s", longest_clog),
]


def register_metric(metric: Metric) -> Metric:
    """Have a metric in every report, behind those that ship; returns it."""
    METRICS.append(metric)
    return metric


def summarise(episodes: Sequence[Episode]) -> list[Summary]:
    """Return every metric over the episodes, in the order of `METRICS`."""
    return [Summary(metric, tuple(metric.compute(episode) for episode in episodes)) for metric in METRICS]


def shown(value: MetricValue) -> str:
    """Return a metric's value as text: four significant digits, or why it is not defined."""
    if isinstance(value, NotDefined):
        return f"not defined: {value.reason}"
    return f"{require_finite(value):.4g}"


def require_finite(value: float) -> float:
    """Return `value`; ValueError for one that is neither a number nor said to be undefined."""
    if not math.isfinite(value):
        raise ValueError(f"a metric must be finite or NotDefined, not {value}")
    return value


def _sum(values: NDArray[np.floating] | NDArray[np.integer]) -> float:
    return float(values.sum())


def _share(part: float, whole: float, otherwise: NotDefined) -> MetricValue:
    return otherwise if whole == 0 else float(part) / float(whole)


def _without_forces(episode: Episode) -> bool:
    """Return whether the episode ran in a world that knows no forces: its energies are NaN."""
    return bool(np.isnan(episode.totals.energy).any())


def _no_visit(episode: Episode) -> NotDefined:
    return NO_TUNNEL if episode.tunnels.count == 0 else NEVER_IN_TUNNEL


def _no_clog(episode: Episode) -> NotDefined:
    return NO_TUNNEL if episode.tunnels.count == 0 else NotDefined("no clogs")


def _mean_of_windows(episode: Episode, values: Floats) -> MetricValue:
    if episode.tunnels.count == 0:
        return NO_TUNNEL
    return float(values.mean()) if len(values) else NotDefined("the run is shorter than 30 s")
