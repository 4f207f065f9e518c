"""The functions that a worker executes: it makes one run at a time and returns its row."""

from __future__ import annotations

import socket
import time
from typing import Any

from sixthsense.campaigns.plan import AXES, config_hash
from sixthsense.config import Config
from sixthsense.config.version import __version__

FAILED = "error"
"""the outcome of a run that raised"""
CURVES = "curves"
"""key of a row under which a worker returns the run's errors along its way"""


def row_of(config: Config) -> dict[str, Any]:
    """The columns that are known before a run: the configuration's hash, the axes, the task and the seed."""
    return {"config_hash": config_hash(config), **{name: getattr(config, name) for name in (*AXES, "task", "seed")}}


def run_row(config: Config) -> dict[str, Any]:
    """Make one run and return its row; if the run raises, the row has the outcome `FAILED` and a one-line reason."""
    from sixthsense.running.warmup import prepare

    row = {**row_of(config), "host": socket.gethostname(), "version": __version__}
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
    from sixthsense.simulation.mission import mission_of

    run = simulate(*mission_of(config))
    return {**run.metrics, CURVES: curves(run.trace)}
