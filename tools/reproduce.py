"""Run the sweeps of docs/results, in steps that stop and go on, and write docs/results.md from their records.

    python tools/reproduce.py plan             what there is to run, what is done, how long the rest takes
    python tools/reproduce.py run [NAME ...] [--only robots=8] [--workers 2]
    python tools/reproduce.py write            the page and its figures, from the records there are
    python tools/reproduce.py pictures         draw a clog and no clog, from teams that ship
    python tools/reproduce.py --quick          a small comparison from nothing, within ten minutes

Stopped with Ctrl-C, `run` goes on where it was. Records lie beside the sweeps, a line for each run.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robosim.analysis.figures.moments import Moment, save_moments
from robosim.control.controller import make_controller
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError, nearest_names, shown
from robosim.experiments.compare_figures import draw_comparison
from robosim.experiments.comparison import compare
from robosim.experiments.paper import PELLETS, TECHNIQUES
from robosim.experiments.results import Result, read_results
from robosim.experiments.runs import Run, read_runs
from robosim.experiments.sweep import Sweep, read_sweep
from robosim.experiments.tables import WALL_TIME, Column, SweepTable, figure_of, sweep_table
from robosim.files import write_whole

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
IMAGES = ROOT / "docs" / "images"
PAGE = ROOT / "docs" / "results.md"
RUNS = Path("runs")
INTERRUPTED = 130
"""Exit code of a command that was stopped."""

INTRODUCTION = """\
# Results

Every table and figure on this page is made by `python tools/reproduce.py write` from the records in
[docs/results](results/); the words beside them tell what they show. `python tools/reproduce.py run` makes the
records: it can be stopped, goes on where it was, and takes many hours in all on two cores. `python
tools/reproduce.py --quick` shows the same for small teams within ten minutes.
"""
INTERVALS = """\
Pellets in an episode: interquartile mean over seeds and its 95 % bootstrap interval in brackets; single
values where there are fewer than three seeds, `(2 of 3)` where some are missing, "not run" where all are,
"none" where no run is planned, with the reason below the table. More tables open by a click.
"""


@dataclass(frozen=True)
class Section:
    """A part of the page, from one sweep."""

    name: str
    """Of the sweep's file."""
    title: str
    beside_paper: bool = False
    """The paper's figures stand above ours."""
    figures: tuple[str, ...] = ()
    """Of those that `robosim compare` draws."""
    drawn: tuple[int, ...] = ()
    """Sizes of the teams in the figures that have a panel for each; all if empty."""
    also: Mapping[str, str] | None = None
    """Further tables: names of figures, and what they are."""


TOUCHES = {
    "touches": "Touches: decisions in which robots that did not stop touched another, summed over robots."
}
WORK = {
    "gini": "Gini coefficient of the pellets that each robot delivered: 0 where all do the same. There is no "
    "such figure of one robot, nor where nothing was delivered.",
    "one_at_a_time": "Share of the episodes that the classifier calls One-at-a-Time.",
    "bucket_brigade": "Share of the episodes that it calls Bucket-Brigade.",
    "clogged_share": "Share of the time in which the tunnel was clogged.",
}
TIME = {WALL_TIME: "Time to learn, s, in one process with one thread, two of them side by side on two cores."}
CLOG_PICTURE = IMAGES / "results-clog.png"
CLOG_TEAMS = (("paper-2", 1500), ("paper-8-smadrl", 1500))
"""Policies that ship, each to drive eight robots, and the decision at which the picture is taken."""
CLOG_LINES = """\
## A clog, and none

Eight robots in the arena `paper`, in physics, episode of seed 0. Above, the network of `paper-2`, which
learned with two robots: those that carry a pellet block each other before the tunnel, and stay there. Below,
`paper-8-smadrl`, whose robots learned with each other.

    python tools/reproduce.py pictures

![Eight robots jammed in the tunnel, and eight that are not](images/results-clog.png)
"""
CURVES = ("learning-curves", "pellets", "lorenz", "team-size", "profiles", "touches")
SECTIONS = (
    Section("grid", "In the grid world", True, CURVES, (2, 4, 8), TOUCHES | WORK),
    Section("physics", "In physics", True, CURVES, (2, 4, 8), TOUCHES | WORK),
    Section("drawn", "Actor-critics that draw their actions", False),
    Section("drawn-physics", "Actor-critics that draw their actions, in physics", False),
    Section("smadrl", "S-MADRL that scales", False, ("learning-curves",), (), TOUCHES),
    Section("scaling", "Eight robots and one", False),
    Section("default", "Which technique by default?", False, (), (), TOUCHES),
    Section("time", "Eight robots by time", False, (), (), TIME),
    Section("gentle", "What gentleness costs", False, ("touches",), (), TOUCHES),
    Section("curriculum", "What the curriculum costs and brings", False),
    Section("stigmergy", "Does stigmergy help?", False),
    Section("larger", "Larger teams", False, (), (), TOUCHES),
    Section("arenas", "Other arenas", False, (), (), TOUCHES),
    Section(
        "wheels", "Wheel commands", False, (), (), {**TOUCHES, "wheel_energy": "Energy at the wheels, J."}
    ),
    Section("tuning", "The search for settings", False),
)


def sweep_file(name: str) -> Path:
    return RESULTS / f"{name}.toml"


def results_file(name: str) -> Path:
    return RESULTS / f"{name}.results.jsonl"


def there() -> list[Section]:
    """Return the sections whose sweeps exist."""
    return [section for section in SECTIONS if sweep_file(section.name).exists()]


def robosim(*arguments: str) -> int:
    """Run a command of robosim to its end; return its exit code."""
    with subprocess.Popen([sys.executable, "-m", "robosim", *arguments]) as process:
        while True:
            try:
                return process.wait()
            except KeyboardInterrupt:
                # It has been interrupted as well, and ends once its runs are saved.
                continue


def run(names: Sequence[str], extra: Sequence[str]) -> int:
    """Work off the sweeps in the order of the page; return the worst exit code.

    InputError for a name that no sweep has.
    """
    worst, known = 0, [section.name for section in there()]
    for name in names:
        if name not in known:
            raise InputError(f"no sweep is named {shown(name)}: {nearest_names(name, known)}")
    for section in there():
        if names and section.name not in names:
            continue
        print(f"== {section.name}", flush=True)
        out = ("--out", str(RUNS / section.name), "--results", str(results_file(section.name)))
        code = robosim("sweep", str(sweep_file(section.name)), *out, *extra)
        worst = max(worst, code)
        if code == INTERRUPTED:
            break
    return worst


def write() -> None:
    """Write the page and its figures."""
    lines = [INTRODUCTION, *reading("answers"), INTERVALS]
    for section in there():
        lines += [f"## {section.title}", "", *section_lines(section)]
    if CLOG_PICTURE.exists():
        lines += [CLOG_LINES]
    write_whole(PAGE, "\n".join(lines).rstrip() + "\n")
    print(PAGE)


def reading(name: str) -> list[str]:
    """Return what is written by hand beside the records of that name, with links as they are on the page."""
    path = RESULTS / f"{name}.md"
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8").rstrip()
    return [text.replace("](../results.md#", "](#").replace("](../", "]("), ""]


def section_lines(section: Section) -> Iterator[str]:
    """Yield what the page says of a sweep."""
    sweep, results = read_sweep(sweep_file(section.name)), read_results(results_file(section.name))
    done = [results[job.key] for job in sweep.jobs if job.key in results]
    yield f"{sweep.about} {count_line(sweep, done, len(results) - len(done))}"
    yield ""
    yield f"    robosim sweep docs/results/{section.name}.toml"
    yield ""
    if not done:
        return
    table = sweep_table(sweep, results)
    yield from table.lines(above=paper_rows(table) if section.beside_paper else None)
    yield ""
    for sentence in table.reasons():
        yield f"- None of {sentence}"
    yield ""
    yield from reading(section.name)
    for figure, about in (section.also or {}).items():
        if any(figure_of(result, figure) for result in done):
            digits = 0 if figure in {"touches", WALL_TIME} else 2
            lines = sweep_table(sweep, results, figure).lines(digits)
            yield from folded(about, lines)
    yield from figure_lines(section)


def folded(about: str, lines: Iterable[str]) -> Iterator[str]:
    """Yield lines of Markdown that are seen when a reader opens what `about` says."""
    yield f'<details markdown="1"><summary>{about}</summary>'
    yield ""
    yield from lines
    yield ""
    yield "</details>"
    yield ""


def count_line(sweep: Sweep, done: Sequence[Result], other: int) -> str:
    """Say how much of a sweep has run, and where; `other` records beside it are of no run in it."""
    if not done:
        return f"Not run yet: none of its {len(sweep.jobs)} runs has been made."
    machines = sorted({result.machine.get("processor", "unknown") for result in done})
    gpus = Counter(result.machine["gpu"] for result in done if "gpu" in result.machine)
    learned = "".join(f" {count} of them learned on {gpu}." for gpu, count in sorted(gpus.items()))
    hours = sum(result.wall_time + result.evaluation_time for result in done) / 3600.0
    return (
        f"{len(done)} of {len(sweep.jobs)} runs, {hours:.1f} hours of one core, on {' and '.join(machines)}."
        + learned
        + (f" {other} more records are of trials that the sweep does not hold." if other else "")
    )


def paper_rows(table: SweepTable) -> dict[str, dict[Column, str]]:
    """Return the paper's figures as rows, for the columns of one arena and world."""
    rows: dict[str, dict[Column, str]] = {}
    for technique, method in TECHNIQUES.items():
        sizes = {column: dict(column)["robots"] for column in table.columns}
        rows[f"`{technique}`"] = {
            column: str(PELLETS[method][size - 1]) for column, size in sizes.items() if isinstance(size, int)
        }
    return rows


def figure_lines(section: Section) -> Iterator[str]:
    """Draw the figures of a section and yield the lines that show them."""
    every = read_runs([results_file(section.name)])
    runs = [one for one in every if drawn(section, one)]
    if not runs or not section.figures:
        return
    # One figure has a point for each size, so all of them fit; the others have a panel for each.
    names = sorted({run.system for run in every})
    pictures = dict(draw_comparison(compare(runs), runs, names, section.figures))
    if "team-size" in pictures and len(every) > len(runs):
        pictures.update(draw_comparison(compare(every), every, names, ["team-size"]))
    for name, picture in pictures.items():
        path = IMAGES / f"results-{section.name}-{name}.png"
        path.write_bytes(picture.png)
        yield f"![{section.title}: {name.replace('-', ' ')}](images/{path.name})"
        yield ""


def drawn(section: Section, run: Run) -> bool:
    return not section.drawn or run.task.robots in section.drawn


def pictures() -> None:
    """Draw where the robots are after some time, in a team that jams and in one that does not."""
    moments = []
    for name, decisions in CLOG_TEAMS:
        env = VectorEnv("paper", robots=8, episode_steps=decisions, autoreset=False)
        controller = make_controller(name)
        observation = env.reset(seed=0)
        controller.reset(env)
        for _ in range(decisions):
            observation = env.step(controller.act(env, observation)).final_observation
        title = f"{name}: {int(env.delivered.sum())} pellets in {decisions} decisions"
        moments.append(Moment.of(env.frame(), env.arena, title))
    save_moments(moments, CLOG_PICTURE)
    print(CLOG_PICTURE)


def quick() -> int:
    """Run a small comparison from nothing and print its table."""
    RUNS.mkdir(exist_ok=True)
    code = robosim(
        "sweep",
        str(sweep_file("quick")),
        "--out",
        str(RUNS / "quick"),
        "--results",
        str(RUNS / "quick.results.jsonl"),
    )
    if code:
        return code
    sweep, results = read_sweep(sweep_file("quick")), read_results(RUNS / "quick.results.jsonl")
    print("\n".join(sweep_table(sweep, results).lines()))
    print(INTERVALS)
    return code


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", nargs="?", choices=("plan", "run", "write", "pictures"))
    parser.add_argument("names", nargs="*", help="sweeps by name; all by default")
    parser.add_argument("--only", default=None)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    if options.names and options.what not in {"plan", "run"}:
        parser.error(f"{options.what} takes no names of sweeps: it is about all of them")
    if options.quick and (options.what is not None or options.only is not None):
        parser.error("--quick runs a sweep of its own: it takes neither plan, run nor --only")
    extra = [] if options.only is None else ["--only", options.only]
    if options.workers is not None:
        extra += ["--workers", str(options.workers)]
    if options.quick:
        return quick()
    if options.what in {"plan", "run"}:
        return run(options.names, [*extra, "--dry-run" if options.what == "plan" else "--no-keep-runs"])
    if options.what in {"write", "pictures"}:
        (write if options.what == "write" else pictures)()
        return 0
    parser.print_help()
    return 2


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
