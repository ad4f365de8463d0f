"""Environments split over processes, with the same numbers as in one."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import multiprocessing
import signal
import threading
import traceback
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robosim.arena.model import Arena
from robosim.envs.config import EnvConfig
from robosim.envs.vector import (
    OTHER_THREAD,
    Snapshot,
    Transition,
    VectorEnv,
    checked_actions,
    require_snapshot,
)
from robosim.episodes.frame import Frame
from robosim.errors import InputError, refused, whole_number
from robosim.world.motion import MotionDraws

_PATIENCE = 5.0
"""Time that a worker is given to end by itself, s."""


@overload
def vector_env(
    arena: EnvConfig | Arena | str | Path | None = None,
    *,
    num_envs: int = 1,
    seed: int | Sequence[int] = 0,
    workers: Literal[1] = 1,
    **fields: Any,
) -> VectorEnv: ...


@overload
def vector_env(
    arena: EnvConfig | Arena | str | Path | None = None,
    *,
    num_envs: int = 1,
    seed: int | Sequence[int] = 0,
    workers: int,
    **fields: Any,
) -> VectorEnv | WorkerVectorEnv: ...


def vector_env(
    arena: EnvConfig | Arena | str | Path | None = None,
    *,
    num_envs: int = 1,
    seed: int | Sequence[int] = 0,
    workers: int = 1,
    **fields: Any,
) -> VectorEnv | WorkerVectorEnv:
    """Return a batch of environments: arrays [envs, robots, ...], each beginning anew by itself at its end.

    `arena` is a configuration or an arena, `fields` replace fields of it, as in `env_config`; with
    `autoreset=False` besides, an episode that has ended stays so until `reset`. With `workers` above 1 the
    environments are shared out to that many processes, with the same numbers to the bit; use it as a context
    manager, or call close(). Raises InputError.
    """
    if isinstance(workers, int | np.integer) and workers == 1 and not isinstance(workers, bool):
        return VectorEnv(arena, num_envs=num_envs, seed=seed, **fields)
    return WorkerVectorEnv(arena, num_envs=num_envs, seed=seed, workers=workers, **fields)


@dataclass(frozen=True)
class _Failure:
    """What a worker sends when something broke that is not the user's doing."""

    traceback: str


class WorkerVectorEnv:
    """A `VectorEnv` whose environments live in other processes.

    It has what learners use of a `VectorEnv`; scripted controllers look into the world and need a
    `VectorEnv` itself. Processes are spawned, so a script needs its `if __name__ == "__main__":`.
    """

    def __init__(
        self,
        arena: EnvConfig | Arena | str | Path | None = None,
        *,
        num_envs: int,
        seed: int | Sequence[int] = 0,
        workers: int,
        **fields: Any,
    ) -> None:
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise InputError(
                "vector_env: workers import this script anew, and it asks for workers at once; put what it "
                'does under `if __name__ == "__main__":`.'
            )
        # Wrong input is found here, before any process is spawned, in the words of VectorEnv.
        sample = VectorEnv(arena, num_envs=num_envs, seed=seed, **fields)
        number = isinstance(workers, int | np.integer) and not isinstance(workers, bool)
        if not number or not 1 <= workers <= num_envs:
            raise refused("workers", workers, f"a whole number from 1 to num_envs, {num_envs}")
        self.seeds_from = sample.seeds_from
        self.config = sample.config
        self.arena = sample.arena
        self.layout = sample.layout
        self.num_actions = sample.num_actions
        self.episode_steps = sample.episode_steps
        self.num_envs = num_envs
        self.robots = robots = sample.robots
        context = multiprocessing.get_context("spawn")
        kinds = _kinds(num_envs, robots, self.layout.size)
        self._memory = {name: context.RawArray(ctypes.c_char, kind.itemsize) for name, kind in kinds.items()}
        self._arrays = _arrays(self._memory, kinds)
        bounds = np.linspace(0, num_envs, workers + 1).astype(int).tolist()
        self._shares = [slice(first, last) for first, last in itertools.pairwise(bounds)]
        self._pipes: list[Connection[Any, Any]] = []
        self._processes: list[BaseProcess] = []
        self._close = weakref.finalize(self, _end, self._pipes, self._processes)
        self._cut_short = False
        self._inside: int | None = None
        """The thread in the midst of an exchange."""
        for share in self._shares:
            ours, theirs = context.Pipe()
            own = {"base": self.config, "seed": sample.seeds[share], "autoreset": sample.autoreset}
            process = context.Process(
                target=_work, args=(theirs, self._memory, kinds, share, own), daemon=True
            )
            process.start()
            theirs.close()
            self._pipes.append(ours)
            self._processes.append(process)
        with self._exchange():
            self._answers()

    def _repr_html_(self) -> str:
        from robosim.envs.picture import environment_html

        return environment_html(self)

    def reset(self, seed: int | Sequence[int] | None = None) -> NDArray[np.float32]:
        """Begin an episode in every environment; returns the observations [envs, robots, size]."""
        seeds = None if seed is None else self.seeds_from(seed)
        with self._exchange():
            for worker, share in enumerate(self._shares):
                self._send(worker, ("reset", None if seeds is None else seeds[share]))
            self._answers()
        return self._copy("observation")

    def step(self, actions: ArrayLike) -> Transition:
        """Take one decision in every environment: `actions` is [envs, robots]."""
        chosen = checked_actions(actions, (self.num_envs, self.robots), self.num_actions)
        with self._exchange():
            self._arrays["actions"][:] = chosen
            self._ask_all("step")
        return Transition(**{name: self._copy(name) for name in Transition._fields})

    def snapshot(self) -> Snapshot:
        """Return the present moment, as that of a `VectorEnv` of the same environments."""
        with self._exchange():
            parts = self._ask_all("snapshot")
        seeds = tuple(seed for part in parts for seed in part.seeds)
        return Snapshot(seeds, parts[0].episode, np.concatenate([part.actions for part in parts], axis=1))

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Return to a moment, exact to the last bit; returns the observations [envs, robots, size]."""
        require_snapshot(snapshot)
        snapshot.require_size(self.num_envs, self.robots)
        with self._exchange():
            for worker, share in enumerate(self._shares):
                part = Snapshot(snapshot.seeds[share], snapshot.episode, snapshot.actions[:, share])
                self._send(worker, ("restore", part))
            self._answers()
        return self._copy("observation")

    @property
    def joint_decisions(self) -> int:
        """Joint decisions that a step takes: one in each environment."""
        return self.num_envs

    @property
    def delivered(self) -> NDArray[np.int64]:
        """[envs, robots] pellets delivered by each robot in the current episode."""
        return self._copy("delivered")

    @property
    def drawn(self) -> tuple[MotionDraws, ...] | None:
        """[envs] what the present episodes have drawn from the profile; None without one, before a reset."""
        with self._exchange():
            parts = self._ask_all("drawn")
        return None if parts[0] is None else tuple(one for part in parts for one in part)

    def frame(self, env: int = 0) -> Frame:
        """Return what a recorder reads of one environment after reset() and after each step()."""
        env = whole_number("frame: env", env, 0, self.num_envs - 1)
        worker = next(number for number, share in enumerate(self._shares) if env < share.stop)
        with self._exchange():
            self._send(worker, ("frame", env - self._shares[worker].start))
            frame: Frame = self._receive(worker)
        contacts = replace(frame.contacts, env=np.full_like(frame.contacts.env, env))
        return replace(frame, contacts=contacts)

    def close(self) -> None:
        """End the processes; nothing can be done with this object afterwards."""
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[None]:
        """Hold one exchange of questions and answers with the workers.

        An interrupt in the middle of one, as by Ctrl-C in a notebook, leaves answers in the pipes that the
        next question would take for its own. So nothing is asked any more after that.
        """
        if self._inside not in (None, threading.get_ident()):
            raise InputError(f"vector_env: {OTHER_THREAD}")
        if self._cut_short:
            self.close()
            raise InputError(
                "vector_env: a decision was interrupted, and what has become of it is not known; "
                "the environments are closed, make new ones."
            )
        self._cut_short, self._inside = True, threading.get_ident()
        try:
            yield
        except Exception:
            self._cut_short = False
            raise
        finally:
            self._inside = None
        self._cut_short = False

    def _ask_all(self, command: str) -> list[Any]:
        for worker in range(len(self._shares)):
            self._send(worker, (command, None))
        return self._answers()

    def _answers(self) -> list[Any]:
        """Wait for every worker, so that no answer is left over; then raise what failed first."""
        failures, answers = [], []
        for worker in range(len(self._shares)):
            try:
                answers.append(self._receive(worker))
            except (InputError, RuntimeError) as error:
                failures.append(error)
            if not self._close.alive:
                break
        if failures:
            raise failures[0]
        return answers

    def _send(self, worker: int, message: tuple[str, object]) -> None:
        if not self._close.alive:
            raise InputError("vector_env: the environments are closed; make new ones.")
        try:
            self._pipes[worker].send(message)
        except OSError:
            raise self._died(worker) from None

    def _receive(self, worker: int) -> Any:
        try:
            answer = self._pipes[worker].recv()
        except (EOFError, OSError):
            raise self._died(worker) from None
        if isinstance(answer, InputError):
            raise answer
        if isinstance(answer, _Failure):
            raise RuntimeError(f"worker {worker} of {len(self._shares)} failed:\n{answer.traceback}")
        return answer

    def _died(self, worker: int) -> RuntimeError:
        process = self._processes[worker]
        process.join(_PATIENCE)
        code = process.exitcode
        self.close()
        return RuntimeError(f"worker {worker} of {len(self._shares)} ended unexpectedly, exit code {code}.")

    def _copy(self, name: str) -> NDArray[Any]:
        return self._arrays[name].copy()


def _kinds(num_envs: int, robots: int, size: int) -> dict[str, np.dtype[Any]]:
    """Return kind and shape of every array that the processes share; the first axis is the environment."""
    each, per_robot, per_number = (num_envs,), (num_envs, robots), (num_envs, robots, size)
    return {
        "actions": np.dtype((np.int64, per_robot)),
        "observation": np.dtype((np.float32, per_number)),
        "reward": np.dtype((np.float32, per_robot)),
        "terminated": np.dtype((np.bool_, each)),
        "truncated": np.dtype((np.bool_, each)),
        "final_observation": np.dtype((np.float32, per_number)),
        "final_delivered": np.dtype((np.int64, per_robot)),
        "collided": np.dtype((np.bool_, per_robot)),
        "blocked": np.dtype((np.bool_, per_robot)),
        "delivered": np.dtype((np.int64, per_robot)),
    }


def _arrays(memory: dict[str, Any], kinds: dict[str, np.dtype[Any]]) -> dict[str, NDArray[Any]]:
    return {
        name: np.frombuffer(memory[name], dtype=kind.base).reshape(kind.shape) for name, kind in kinds.items()
    }


def _work(
    pipe: Connection[Any, Any],
    memory: dict[str, Any],
    kinds: dict[str, np.dtype[Any]],
    share: slice,
    arguments: dict[str, Any],
) -> None:
    """Serve one share of the environments until the other end of the pipe closes."""
    # Ctrl-C reaches the whole group of processes; who ends and when is the parent's to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    arrays = {name: array[share] for name, array in _arrays(memory, kinds).items()}
    message: tuple[str, Any] = ("make", None)
    env: VectorEnv | None = None
    while True:
        answer: object = None
        try:
            if env is None:
                env = VectorEnv(num_envs=share.stop - share.start, **arguments)
            command, argument = message
            if command == "reset":
                arrays["observation"][:] = env.reset(argument)
            elif command == "step":
                for name, value in env.step(arrays["actions"])._asdict().items():
                    arrays[name][:] = value
            elif command == "restore":
                arrays["observation"][:] = env.restore(argument)
            elif command in ("snapshot", "drawn"):
                answer = env.snapshot() if command == "snapshot" else env.drawn
            elif command == "frame":
                answer = env.frame(argument)
            arrays["delivered"][:] = env.delivered
        except InputError as error:
            answer = error
        except Exception:  # noqa: BLE001 - the parent raises it
            answer = _Failure(traceback.format_exc())
        try:
            pipe.send(answer)
            message = pipe.recv()
        except (EOFError, OSError):
            return


def _end(pipes: list[Connection[Any, Any]], processes: list[BaseProcess]) -> None:
    """Close the pipes, which ends the workers, and wait for them."""
    for pipe in pipes:
        pipe.close()
    for process in processes:
        process.join(_PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()
        process.close()
