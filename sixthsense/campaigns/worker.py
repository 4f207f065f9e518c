"""The functions that a worker executes: it makes one run at a time and returns its row."""

from __future__ import annotations

import platform
import socket
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any, Literal

from sixthsense.campaigns.plan import AXES, config_hash, scene_digest
from sixthsense.config import Config
from sixthsense.config.parts import KINDS
from sixthsense.config.version import __version__

FAILED = "error"
"""the outcome of a run that raised"""
CURVES = "curves"
"""key of a row under which a worker returns the run's errors along its way"""

# Runs limit BLAS to one thread for the whole process and measure wall time, so threads must not overlap.
_run_lock = threading.Lock()


class OtherVersionError(Exception):
    """A worker that joined after the others has another version of the package."""


def python_minor() -> str:
    """The minor version of Python, such as 3.12."""
    return ".".join(platform.python_version_tuple()[:2])


def describe(
    scenes: Sequence[str], map_unknown: Literal["wall", "free"], parts: Sequence[tuple[str, str]] = ()
) -> dict[str, Any]:
    """What must be equal on all workers: the versions, the scenes' hashes, and why a part cannot be imported."""
    missing = []
    for kind, name in parts:
        try:
            next(known for known in KINDS if known.kind == kind).load(name)
        except ValueError as error:
            missing.append(str(error))
    digests = {}
    for scene in scenes:
        try:
            digests[scene] = scene_digest(scene, map_unknown)
        except ValueError as error:
            digests[scene] = str(error)
    return {
        "sixthsense": __version__,
        "python": python_minor(),
        "scenes": digests,
        "missing": missing,
        "environment": sys.prefix,
    }


def row_of(config: Config) -> dict[str, Any]:
    """The columns that are known before a run: the configuration's hash, the axes, the task and the seed."""
    return {"config_hash": config_hash(config), **{name: getattr(config, name) for name in (*AXES, "task", "seed")}}


def run_row(config: Config, version: str) -> dict[str, Any]:
    """Make one run and return its row; if the run raises, the row has the outcome `FAILED` and a one-line reason.

    Raises OtherVersionError if the package has another version than `version`.
    """
    if version != __version__:
        raise OtherVersionError(f"found version {__version__} of sixthsense, allowed: {version}")
    from sixthsense.running.warmup import prepare

    with _run_lock:
        row = {**row_of(config), "host": socket.gethostname(), "version": version}
        began = time.perf_counter()
        try:
            prepare(lambda _: None, config)  # keeps the compilation out of the run's time
            began = time.perf_counter()
            row |= _metrics(config)
        except Exception as error:
            row |= {"outcome": FAILED, "error": one_line(error)}
        return {**row, "run_time_s": time.perf_counter() - began}


def failed_row(config: Config, error: BaseException) -> dict[str, Any]:
    """The row of a run whose worker has failed."""
    # The message of Dask's KilledWorker is several sentences long.
    is_killed = type(error).__name__ == "KilledWorker"
    reason = f"LostWorkerError: {error.args[2] + 1} workers died in this run" if is_killed else one_line(error)
    return {**row_of(config), "version": __version__, "outcome": FAILED, "error": reason}


def one_line(error: BaseException) -> str:
    """An exception's type and message in one line of at most 500 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _metrics(config: Config) -> dict[str, Any]:
    """The metrics of a run, and its errors along its way."""
    from sixthsense.evaluation.curves import curves
    from sixthsense.running.runs import simulate

    run = simulate(config)
    return {**run.metrics, CURVES: curves(run.trace)}
