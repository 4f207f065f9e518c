"""The functions that a worker executes: it makes one run at a time and returns its row."""

from __future__ import annotations

import platform
import socket
import threading
import time
from collections.abc import Sequence
from typing import Any, Literal

from sixthsense.campaigns.plan import AXES, config_hash, scene_digest
from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.parts import KINDS
from sixthsense.config.version import __version__

FAILED = "error"
"""the outcome of a run that raised"""
CURVES = "curves"
"""key of a row under which a worker returns the run's errors along its way"""

# Runs limit BLAS to one thread for the whole process and measure wall time, so threads must not overlap.
_run_lock = threading.Lock()


def describe(
    scenes: Sequence[str], map_unknown: Literal["wall", "free"], parts: Sequence[tuple[str, str]] = ()
) -> dict[str, str]:
    """What must be equal on all workers: versions, and the hash of each scene.

    Raises InputError for a part, by kind and name, that cannot be imported, and for a scene that cannot be loaded.
    """
    for kind, name in parts:
        next(known for known in KINDS if known.kind == kind).load(name)
    found = {"Python": ".".join(platform.python_version_tuple()[:2]), "sixthsense": __version__}
    return found | {f"scene {scene}": scene_digest(scene, map_unknown) for scene in scenes}


def row_of(config: Config) -> dict[str, Any]:
    """The columns that are known before a run: the configuration's hash, the axes, the task and the seed."""
    return {"config_hash": config_hash(config), **{name: getattr(config, name) for name in (*AXES, "task", "seed")}}


def run_row(config: Config, version: str) -> dict[str, Any]:
    """Make one run and return its row; if the run raises, the row has the outcome `FAILED` and a one-line reason.

    Raises InputError if the package has another version than `version`, as that of a worker that joined late may.
    """
    if version != __version__:
        raise InputError("worker that joined late", f"found version {__version__} of sixthsense", version)
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
    return {**row_of(config), "version": __version__, "outcome": FAILED, "error": one_line(error)}


def one_line(error: BaseException) -> str:
    """An exception's type and message in one line of at most 500 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _metrics(config: Config) -> dict[str, Any]:
    """The metrics of a run, and its errors along its way."""
    from sixthsense.evaluation.curves import curves
    from sixthsense.running.runs import simulate

    run = simulate(config)
    return {**run.metrics, CURVES: curves(run.trace)}
