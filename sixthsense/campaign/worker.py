"""What a worker does: one run after the other, of each only the row goes back."""

from __future__ import annotations

import platform
import socket
import threading
import time
from collections.abc import Sequence
from typing import Any

from sixthsense.campaign.plan import config_hash, scene_digest
from sixthsense.config import Config
from sixthsense.config.version import __version__

FAILED = "error"
"""the outcome of a run that raised"""

# A run keeps BLAS to one thread, for the whole process, and its clock is a stopwatch: threads take turns.
_turn = threading.Lock()


class OtherVersionError(Exception):
    """A worker that joined after the others has another version of the package."""


def python_minor() -> str:
    """Such as 3.12."""
    return ".".join(platform.python_version_tuple()[:2])


def describe(scenes: Sequence[str]) -> dict[str, Any]:
    """What must be alike on every worker: versions, and what the scenes hold."""
    digests = {}
    for scene in scenes:
        try:
            digests[scene] = scene_digest(scene)
        except ValueError as error:
            digests[scene] = str(error)
    return {"sixthsense": __version__, "python": python_minor(), "scenes": digests}


def row_of(config: Config) -> dict[str, Any]:
    """What is known of a run before it has begun: its configuration's hash and what a campaign varies or shares."""
    names = ("scene", "estimator", "preset", "planner", "task", "seed")
    return {"config_hash": config_hash(config), **{name: getattr(config, name) for name in names}}


def run_row(config: Config, version: str) -> dict[str, Any]:
    """Make one run and return its row; a run that raises is a row with the outcome `FAILED` and the reason in one line.

    Raises OtherVersionError where the package is not of that `version`.
    """
    if version != __version__:
        raise OtherVersionError(f"found version {__version__} of sixthsense, allowed: {version}")
    from sixthsense.running.warmup import prepare

    with _turn:
        row = {**row_of(config), "host": socket.gethostname(), "version": version}
        began = time.perf_counter()
        try:
            prepare(lambda _: None)  # so that no run's time has the compilation
            began = time.perf_counter()
            row |= _metrics(config)
        except Exception as error:
            row |= {"outcome": FAILED, "error": one_line(error)}
        return {**row, "run_time_s": time.perf_counter() - began}


def one_line(error: BaseException) -> str:
    """An exception's kind and text without line breaks, of bounded length."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _metrics(config: Config) -> dict[str, Any]:
    from sixthsense.running.runs import simulate

    return simulate(config).metrics
