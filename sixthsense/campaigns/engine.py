"""Many runs: each has a key, is made in some process, and becomes a row that is appended to a file.

Campaigns and benchmarks make their runs so. A command that is stopped keeps its rows, and the next one makes those that
are missing.
"""

from __future__ import annotations

import contextlib
import json
import math
import multiprocessing
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from multiprocessing import connection
from pathlib import Path
from typing import Any, Protocol, TypeVar

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.loop.interrupt import terminal_blocked
from sixthsense.record.writing import naming

T = TypeVar("T")
Row = dict[str, Any]

MOST_DEATHS = 4
"""processes that may die in one run"""


class Rows:
    """Rows by their key in a file of JSON lines, written by one process; of two with one key the later counts.

    A process that was killed may have cut the last line, which is left out.
    """

    def __init__(self, file: Path, key: str = "key") -> None:
        """Use a `file`, which may be missing, whose rows are told apart by the value of `key`."""
        self.file, self.key = file, key

    def read(self) -> dict[str, Row]:
        """The rows by key, in the order of their first lines; InputError, which names the line, for a damaged one."""
        found: dict[str, Row] = {}
        if not self.file.is_file():
            return found
        try:
            lines = self.file.read_bytes().split(b"\n")
        except OSError as error:
            raise InputError(self.file, f"cannot be read ({error.strerror})", "rows of runs") from None
        for number, line in enumerate(lines[:-1], start=1):
            try:
                row = json.loads(line)
                found[row[self.key]] = row
            except (ValueError, KeyError, TypeError, RecursionError):
                raise InputError(self.file, f"line {number}: found {shown(line)}", "a row of a run") from None
        return found

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row; raises OSError that names the file."""
        with naming(self.file):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open("ab+") as stream:
                if end := stream.tell():
                    stream.seek(end - 1)
                    if stream.read() != b"\n":
                        stream.seek(0)
                        stream.truncate(stream.read().rfind(b"\n") + 1)
                stream.write(json.dumps(row).encode() + b"\n")


class Executor(Protocol):
    """What makes runs."""

    @property
    def workers(self) -> int:
        """The number of runs that it makes at a time, at present."""
        ...

    def submit(self, function: Callable[[T], Any], item: T) -> Future[Any]:
        """Begin a call."""
        ...


def carry_out(
    executor: Executor, function: Callable[[T], Any], items: Mapping[str, T], until: float = math.inf
) -> Iterator[tuple[str, Future[Any]]]:
    """Key and finished future of each call of `function` on an item, as they end.

    No more begin than there are workers, so that a lost worker costs one run; and none after the time `until`, s. Those
    that run when the iterator is closed are cancelled.
    """
    waiting, running = iter(items.items()), dict[Future[Any], str]()
    try:
        while True:
            while len(running) < max(1, executor.workers) and time.time() <= until:
                key, item = next(waiting, (None, None))
                if key is None or item is None:
                    break
                running[executor.submit(function, item)] = key
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future
    finally:
        for future in running:
            future.cancel()


class LostWorkerError(Exception):
    """A run in which its process died again and again."""


def processors() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Processes:
    """Processes of this machine that make a run each at a time; a context manager that ends them.

    A process that dies is replaced, and its run made again, up to `MOST_DEATHS` times. They end with the process that
    has started them, whatever ends that. A program that calls this outside of `if __name__ == "__main__"` does not
    begin again in each, unless the function to call is its own.
    """

    def __init__(self, workers: int | None = None, initialize: Callable[[], object] | None = None) -> None:
        """Use `workers` processes, by default one per processor, each of which calls `initialize` once."""
        self.workers = workers or processors()
        self._initialize = initialize
        self._threads = ThreadPoolExecutor(self.workers, "run")
        self._idle: queue.SimpleQueue[_Worker] = queue.SimpleQueue()
        self._all: list[_Worker] = []
        self._closed = threading.Event()

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        for worker in self._all:
            worker.process.kill()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._all:
            worker.process.join()

    def submit(self, function: Callable[[T], Any], item: T) -> Future[Any]:
        """Begin a call; an exception of it is that of the future, LostWorkerError if its process died too often."""
        return self._threads.submit(self._call, function, item)

    def _call(self, function: Callable[[T], Any], item: T) -> Any:
        for _ in range(MOST_DEATHS):
            try:
                worker = self._idle.get_nowait()
            except queue.Empty:
                worker = _Worker(self._initialize, function)
                self._all.append(worker)
                if self._closed.is_set():
                    worker.process.kill()
            try:
                is_done, found = worker.call(function, item)
            except (EOFError, OSError):
                if self._closed.is_set():
                    break
                continue
            self._idle.put(worker)
            if is_done:
                return found
            raise found
        raise LostWorkerError(f"{MOST_DEATHS} workers died in this run")


class _Worker:
    """A process and the pipe to it."""

    def __init__(self, initialize: Callable[[], object] | None, function: Any) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pipe, other = spawn.Pipe()
        self.process = spawn.Process(target=_serve, args=(other, initialize), daemon=True)
        while isinstance(function, partial):
            function = function.func
        is_own = getattr(function, "__module__", "") == "__main__"
        with terminal_blocked(), contextlib.nullcontext() if is_own else _script_hidden():
            self.process.start()
        other.close()

    def call(self, function: Callable[[T], Any], item: T) -> tuple[bool, Any]:
        """Whether the call returned, and what; or what it raised. EOFError or OSError if the process has died."""
        self._pipe.send((function, item))
        found: tuple[bool, Any] = self._pipe.recv()
        return found


def _serve(pipe: connection.Connection, initialize: Callable[[], object] | None) -> None:
    """In a process: answer calls until the pipe is closed, and end with the process that has started this one."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    if initialize is not None:
        initialize()
    with contextlib.suppress(EOFError):
        while True:
            function, item = pipe.recv()
            try:
                answer = True, function(item)
            except Exception as error:
                answer = False, error
            try:
                pipe.send(answer)
            except Exception as error:  # what cannot be sent
                pipe.send((False, RuntimeError(f"{type(error).__name__}: {error}")))


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


_hiding = threading.Lock()


@contextlib.contextmanager
def _script_hidden() -> Iterator[None]:
    """Within the block new processes do not import the program that is running."""
    main = sys.modules["__main__"]
    with _hiding:
        before = {name: getattr(main, name) for name in ("__spec__", "__file__") if hasattr(main, name)}
        main.__spec__ = None
        vars(main).pop("__file__", None)
        try:
            yield
        finally:
            vars(main).update(before)
