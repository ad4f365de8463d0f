"""`robosim evaluate`: measure trained policies and scripted controllers."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from robosim.cli.progress import episodes_shown, progress
from robosim.errors import without_controls

if TYPE_CHECKING:
    from robosim.analysis.measure.monitor import TeamMonitor
    from robosim.control.card import Evaluation
    from robosim.control.controller import Controller
    from robosim.envs.profile import ProfileConfig
    from robosim.envs.vector import VectorEnv
    from robosim.experiments.standings import Standing


@dataclass(frozen=True)
class Evaluate:
    """Run whole episodes without exploration, and count the pellets delivered, by one team or by several."""

    policy: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY...")]
    """Trained policy by name, policy or run folder, or scripted controller by name. Several are shown in one
    table with the 95 % intervals of their means; in equal arenas with equal team sizes they begin from the
    same episodes."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the one a policy learned in, or `paper`."""
    robots: int | None = None
    """Team size; by default a policy's own, or 4."""
    world: Literal["physics", "grid"] | None = None
    """Rigid bodies, or one robot a cell; by default the world that a policy learned in, or `physics`."""
    profile: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE.toml")] = None
    """What is random and wrong about robots and what they perceive, by name or file (docs/noise.md); by
    default nothing, whatever profile a policy learned under."""
    odometry: Annotated[float | None, tyro.conf.arg(metavar="WEIGHT")] = None
    """Robots go on from late, lost and wild fixes by the turns of their wheels: the weight of a new fix
    beside that, above 0 and up to 1 (0.3 does well). By default what the profile says."""
    episodes: int = 5
    """Episodes, run side by side."""
    steps: int | None = None
    """Decisions in an episode; by default as many as the arena says."""
    seed: int = 0
    """Root of all randomness."""
    json: Path | None = None
    """File to write the evaluation to."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """New folder to write a report on congestion to: a page, figures, tables, the episodes."""
    robustness: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """New folder for what each noise alone costs a team, or several side by side: figure, tables, JSON. Takes
    the time of about forty evaluations of each."""

    def run(self) -> None:
        """Evaluate and print the figures."""
        from robosim.control.controller import make_controller
        from robosim.control.evaluate import Watch, evaluate
        from robosim.envs.config import MOST_STEPS
        from robosim.envs.vector import MAX_SEED
        from robosim.errors import whole_number
        from robosim.files import require_apart, require_writable, write_whole

        require_apart({"--json": self.json, "--report": self.report, "--robustness": self.robustness}, ())
        whole_number("--episodes", self.episodes, 1, 10_000)
        whole_number("--seed", self.seed, 0, MAX_SEED)
        if self.steps is not None:
            whole_number("--steps", self.steps, 1, MOST_STEPS)
        if self.json is not None:
            require_writable(self.json)
        self._check_number_of_teams()
        monitor = self._monitor()
        self._check_robustness()
        # All of them first: a mistake in the last name is to be said before the episodes of the others run.
        teams = [
            (controller, self._environment(controller)) for controller in map(make_controller, self.policy)
        ]
        if len(teams) > 1:
            self._evaluate_several(teams)
            return
        ((controller, env),) = teams
        with episodes_shown(env, self.episodes) as shown:
            watch: list[Watch] = [monitor, shown] if monitor else [shown]
            result = evaluate(controller, env, self.episodes, self.seed, watch=watch)
        result = result.changed(trained=_trained(controller))
        print(summary(result), flush=True)
        if self.json is not None:
            write_whole(self.json, result.model_dump_json(indent=2) + "\n")
        if self.report is not None and monitor is not None:
            self._write_report(self.report, result, monitor)
        if self.robustness is not None:
            self._write_robustness(self.robustness, [(controller, env, result)])

    def _check_number_of_teams(self) -> None:
        from robosim.control.controller import SCRIPTED
        from robosim.errors import InputError

        if not self.policy:
            scripts = ", ".join(SCRIPTED)
            raise InputError(
                "evaluate needs a team: a run folder of yours, a trained policy that `robosim policy list` "
                f"names, or a scripted controller: {scripts}."
            )
        if self.report is not None and len(self.policy) > 1:
            raise InputError(
                f"--report is about one team, but {len(self.policy)} are given: evaluate them one by one."
            )

    def _environment(self, controller: Controller) -> VectorEnv:
        from robosim.control.environment import environment_for

        return environment_for(
            controller,
            self.arena,
            self.robots,
            self.world,
            num_envs=min(self.episodes, 16),
            seed=self.seed,
            episode_steps=self.steps,
            profile=self.profile,
            odometry=self.odometry,
        )

    def _evaluate_several(self, teams: Sequence[tuple[Controller, VectorEnv]]) -> None:
        """Evaluate one team after the other, and print and write what they did in one table."""
        import json

        from robosim.control.evaluate import evaluate
        from robosim.experiments.standings import standing
        from robosim.files import write_whole

        for controller, env in teams:
            # Does it fit? To be said of the last team, too, before the first one's episodes.
            env.reset()
            controller.reset(env)
        results = []
        for controller, env in teams:
            with episodes_shown(env, self.episodes) as shown:
                result = evaluate(controller, env, self.episodes, self.seed, watch=[shown])
            results.append(result.changed(trained=_trained(controller)))
        standings = [standing(result) for result in results]
        print("\n".join(lines_of(standings)), flush=True)
        if self.json is not None:
            records = [one.as_record() for one in standings]
            write_whole(self.json, json.dumps(records, indent=2, allow_nan=False) + "\n")
        if self.robustness is not None:
            studied = zip(teams, results, strict=True)
            self._write_robustness(self.robustness, [(*team, result) for team, result in studied])

    def _check_robustness(self) -> None:
        """Say now, before the episodes run, what would keep the study from being written."""
        if self.robustness is not None:
            from robosim.analysis.figures.robustness import MOST_TEAMS
            from robosim.analysis.report.folder import require_folder
            from robosim.errors import InputError

            if len(self.policy) > MOST_TEAMS:
                raise InputError(
                    f"--robustness draws at most {MOST_TEAMS} teams, but {len(self.policy)} are given."
                )
            require_folder(self.robustness)

    def _write_robustness(
        self, folder: Path, teams: Sequence[tuple[Controller, VectorEnv, Evaluation]]
    ) -> None:
        """Measure the teams under each noise, one after the other, and write what was found."""
        import json

        from robosim.analysis.figures.rendering import render
        from robosim.analysis.figures.robustness import draw_robustness
        from robosim.analysis.figures.style import look
        from robosim.analysis.report.folder import whole_folder
        from robosim.analysis.robustness import (
            Level,
            measure_robustness,
            noises_for,
            require_pellets,
            table_of,
        )

        def tell(noise: str, level: Level) -> None:
            print(f"  {noise:<22}  {level.size:g}: {level.share:.2f} of the pellets", flush=True)

        for _, _, reference in teams:
            # Of the last team, too, before the study of the first, which takes long.
            require_pellets(reference)
        found = []
        for controller, env, reference in teams:
            if len(teams) > 1:
                print(f"{reference.controller}:", flush=True)
            found.append(measure_robustness(controller, env, reference, noises_for(env), tell))
        with look():
            figure = render(draw_robustness(found))
        records = [one.model_dump(mode="json") for one in found]
        with whole_folder(folder) as part:
            (part / "robustness.png").write_bytes(figure.png)
            (part / "robustness.svg").write_bytes(figure.svg)
            (part / "robustness.md").write_text("\n".join(map(table_of, found)), encoding="utf-8")
            text = json.dumps(records if len(records) > 1 else records[0], indent=2, allow_nan=False)
            (part / "robustness.json").write_text(text + "\n", encoding="utf-8")
        print(f"  {'robustness':<22}  {folder / 'robustness.md'}")

    def _monitor(self) -> TeamMonitor | None:
        """Return what watches the episodes, if there is to be a report, and there can be one."""
        if self.report is None:
            return None
        import importlib

        # Figures now, too: what they need and is not installed is to be said before the episodes run.
        importlib.import_module("robosim.analysis.figures.catalogue")
        from robosim.analysis.measure.monitor import TeamMonitor
        from robosim.analysis.report.folder import require_folder

        require_folder(self.report)
        return TeamMonitor()

    def _write_report(self, folder: Path, evaluation: Evaluation, monitor: TeamMonitor) -> None:
        from robosim.analysis.report.words import congestion_lines
        from robosim.analysis.report.writer import Watched, write_report

        for name, words in congestion_lines(monitor.episodes):
            print(f"  {name:<22}  {words}", flush=True)
        command = self._command(evaluation)
        with progress("writing the report"):
            page = write_report(folder, Watched(evaluation, monitor.episodes, monitor.trajectories, command))
        print(f"  {'report':<22}  {page}")

    def _command(self, evaluation: Evaluation) -> str:
        """Return the command that makes the same report, with what was left open written out.

        Where to is left out: equal runs make equal reports.
        """
        from robosim.control.controller import SCRIPTED

        # Without an arena, a policy takes the one on its card, which need not have a name here.
        arena = self.arena or (evaluation.arena if self.policy[0] in SCRIPTED else "")
        words = [
            *("robosim", "evaluate", *self.policy),
            *(("--arena", arena) if arena else ()),
            *(("--world", self.world) if self.world else ()),
            *(("--profile", self.profile) if self.profile else ()),
            *(("--odometry", str(self.odometry)) if self.odometry is not None else ()),
            *("--robots", str(evaluation.robots)),
            *("--episodes", str(evaluation.episodes)),
            *("--steps", str(evaluation.episode_steps)),
            *("--seed", str(evaluation.seed)),
            *("--report", "FOLDER"),
        ]
        return shlex.join(words)


def lines_of(standings: Sequence[Standing]) -> list[str]:
    """Return what several teams did as lines of text: a table, a row for each."""
    from robosim.cli.tables import aligned, written

    columns = ["team", "arena", "robots", "pellets per episode, 95 % interval"]
    columns += ["without a delivery", "collisions", "closest (m)"]
    rows = [columns]
    for one in standings:
        what = one.evaluation
        grid = " (grid world)" if what.world == "grid" else ""
        lapse = str(max(what.longest_lapse)) if what.longest_lapse else "-"
        closest = f"{min(what.closest):.4f}" if what.closest else "-"
        rows.append(
            [
                what.controller,
                f"{what.arena}{grid}",
                str(what.robots),
                written(one.pellets, 1),
                lapse,
                written(one.collisions, 1),
                closest,
            ]
        )
    first = standings[0].evaluation
    lengths = {one.evaluation.episode_steps for one in standings}
    length = (
        f"{first.episode_steps} decisions" if len(lengths) == 1 else "as many decisions as each arena says"
    )
    profile = f", profile {_named(first.profile)}" if first.profile else ""
    return [f"{first.episodes} episodes each of {length}, seed {first.seed}{profile}:", *aligned(rows)]


def _named(profile: ProfileConfig) -> str:
    return without_controls(profile.called)


def _trained(controller: Controller) -> str | None:
    """Return the configuration of the run that trained a team, for whoever compares evaluations."""
    from robosim.control.controller import SCRIPTED
    from robosim.control.policy import configuration_of

    return None if controller.name in SCRIPTED else configuration_of(controller.name)


def summary(evaluation: Evaluation) -> str:
    """Return the figures of an evaluation as a few lines."""
    robots = "  ".join(f"{mean:.1f}" for mean in evaluation.per_robot)
    groups = "".join(f"  {group.name:<22}  {group.words()}\n" for group in evaluation.by_group)
    grid = " (grid world)" if evaluation.world == "grid" else ""
    profile = f" (profile {_named(evaluation.profile)})" if evaluation.profile else ""
    spread = f" (standard deviation {evaluation.std:.1f})" if evaluation.episodes > 1 else ""
    episodes = "episodes" if evaluation.episodes > 1 else "episode"
    lapse = ""
    if evaluation.longest_lapse:
        longest = max(evaluation.longest_lapse)
        where = f", in episode {evaluation.longest_lapse.index(longest)}" if evaluation.episodes > 1 else ""
        lapse = f"  without a delivery      at most {longest} decisions{where}\n"
    closest = f"\n  closest, centres        {min(evaluation.closest):.4f} m" if evaluation.closest else ""
    return (
        f"{without_controls(evaluation.controller)} in {evaluation.arena}{grid}{profile}, "
        f"{evaluation.robots} robots, {evaluation.episodes} {episodes} of "
        f"{evaluation.episode_steps} decisions:\n"
        f"  pellets per episode     {evaluation.mean:.1f}{spread}\n"
        f"  of each robot           {robots}\n"
        f"{groups}{lapse}"
        f"  collisions per episode  {sum(evaluation.collisions) / evaluation.episodes:.1f}"
        f"{closest}"
    )
