"""Many runs: each has a key, is made in some process, and becomes a row that is appended to a file.

Campaigns and benchmarks make their runs so. A command that is stopped keeps its rows, and the next one makes those that
are missing.
"""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.logs.runfolder import readable
from sixthsense.loop.interrupt import terminal_blocked
from sixthsense.record.writing import naming

T = TypeVar("T")
Row = dict[str, Any]

_LOOK_S = 0.5  # between two looks at whether the process that has started this one is there


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
        with readable(self.file):
            lines = self.file.read_bytes().split(b"\n")
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
                stream.seek(0)
                stream.truncate(stream.read().rfind(b"\n") + 1)
                stream.write(json.dumps(row).encode() + b"\n")


class LostWorkerError(Exception):
    """A run in which its process died twice."""


def carry_out(
    executor: Any, function: Callable[[T], Any], items: Mapping[str, T], until: float = math.inf
) -> Iterator[tuple[str, Future[Any]]]:
    """Key and finished future of each call of `function` on an item, as they end.

    The executor has a method `submit`, and the number of its `workers`, at present. No more calls begin than there are
    workers, and none after the time `until`, s. A process that dies breaks its pool: the calls that were running begin
    once more, one after the other, so that the one whose process dies again is known; its future has a LostWorkerError.
    Those that run when the iterator is closed end with their executor.
    """
    waiting, running = iter(items.items()), dict[Future[Any], tuple[str, T]]()
    again: list[tuple[str, T]] = []
    tried: set[str] = set()
    while True:
        while len(running) < (1 if again else max(1, executor.workers)) and time.time() <= until:
            key, item = again.pop() if again else next(waiting, (None, None))
            if key is None or item is None:
                break
            running[executor.submit(function, item)] = key, item
            if key in tried:
                break
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            key, item = running.pop(future)
            if not future.cancelled() and isinstance(future.exception(), BrokenProcessPool):
                if key not in tried:
                    tried.add(key)
                    again.append((key, item))
                    continue
                future = Future()
                future.set_exception(LostWorkerError("2 workers died in this run"))
            yield key, future


class Processes:
    """Processes of this machine that make a run each at a time, by loky; a context manager that ends them.

    They end with the process that has started them, whatever ends that. A program that calls this need not do so in
    `if __name__ == "__main__"`.
    """

    def __init__(self, workers: int | None = None, initialize: Callable[[], object] | None = None) -> None:
        """Use `workers` processes, by default one per processor, each of which calls `initialize` once."""
        from loky import cpu_count

        self.workers = workers or cpu_count()
        self._initialize = initialize
        self._pool: Any = None

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(kill_workers=True)

    def submit(self, function: Callable[[T], Any], item: T) -> Future[Any]:
        """Begin a call, in a new pool if a process of the last one has died; its future has BrokenProcessPool then."""
        from loky import ProcessPoolExecutor

        found: Future[Any]
        if self._pool is not None:
            try:
                found = self._pool.submit(function, item)
                return found
            except BrokenProcessPool:
                self._pool.shutdown(kill_workers=True)
        with terminal_blocked():  # which the processes inherit
            self._pool = ProcessPoolExecutor(self.workers, initializer=partial(_begin, os.getpid(), self._initialize))
            found = self._pool.submit(function, item)
        return found


def _begin(parent: int, initialize: Callable[[], object] | None) -> None:
    """In a process: end with the process that has started it, and prepare for calls."""
    from tqdm import tqdm

    tqdm.set_lock(threading.RLock())  # in place of a semaphore, which a process that is killed would leave behind
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    if initialize is not None:
        initialize()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)
