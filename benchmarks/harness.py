"""Shared by the benchmarks: options, timing in alternation, process pools, and figures as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import relations_error
from sixthsense.evaluation.tables import text_table
from sixthsense.figures.run import Run, load
from sixthsense.loop import OnTick
from sixthsense.running.runs import Watch, replay_log, simulate
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations
from sixthsense.sources.replay_input import Recorded

T = TypeVar("T")
R = TypeVar("R")
Figures = dict[str, float]


def run(config: Config, *hooks: OnTick) -> Run:
    """Simulate a configuration, without a progress bar."""
    return simulate(config, watch=Watch(hooks, progress=False))


def replay(log: Log, config: Config, relations: Relations | None = None) -> Run:
    """Replay an open log, without a progress bar."""
    return replay_log(Recorded("log", log, config, relations, {}, ()))


def replay_errors(log: Log, config: Config, relations: Relations) -> dict[str, Any]:
    """Outcome of a replay, errors against relations whose scans the log has, and processor time without reading."""
    began = time.process_time()
    trace = replay(log, config, relations).trace
    spent_s = time.process_time() - began
    stamps_s, poses = np.array(trace.log_stamps_s), trace.scan_poses()
    errors_m, angles = relations_error(stamps_s, poses, relations.stamps, relations.poses)
    return {
        "outcome": trace.outcome, "relations": len(errors_m),
        "mean_m": float(errors_m.mean()), "std_m": float(errors_m.std()),
        "mean_deg": float(np.degrees(angles).mean()), "largest_m": float(errors_m.max()),
        "beyond_0.5_m": float((errors_m > 0.5).mean()), "processor_s": spent_s, "recorded_s": log.duration_s,
    }  # fmt: skip


def command_figures(file: Path, relations: Path) -> Figures:
    """Speed, memory and error of the command `sixthsense replay` with the defaults, in a process of its own."""
    with tempfile.TemporaryDirectory() as out:
        call = [sys.executable, "-c", "import sys; from sixthsense.cli import main; sys.exit(main())"]
        inputs = ["replay", str(file), "--relations", str(relations), "--out", f"{out}/run"]
        process = subprocess.Popen([*call, *inputs], stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if status != 0:
            raise RuntimeError(f"sixthsense replay: found exit status {process.returncode}, allowed: 0")
        made = load(f"{out}/run")
    ms, spent_s = made.trace.stopwatch.keyframe_ms(), used.ru_utime + used.ru_stime
    tenth = max(1, len(ms) // 10)
    return {
        "times_recorded": made.metrics["sim_time_s"] / spent_s, "processor_s": spent_s,
        "keyframe_ms_p50": float(np.percentile(ms, 50)), "keyframe_ms_p99": float(np.percentile(ms, 99)),
        "last_over_second_tenth": float(ms[-tenth:].mean() / ms[tenth : 2 * tenth].mean()),
        "memory_mb": used.ru_maxrss / 1024.0, "mean_m": made.metrics["relations_trans_m_mean"],
    }  # fmt: skip


def arguments(description: str | None) -> argparse.ArgumentParser:
    """A parser with the options that every benchmark has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as flat keys")
    return parser


def check_at_least(parser: argparse.ArgumentParser, options: argparse.Namespace, **bounds: float) -> None:
    """End the program with one line if an option is below its bound; an option that is None was not given."""
    for name, least in bounds.items():
        value = getattr(options, name)
        if value is not None and not value >= least:
            parser.error(f"--{name.replace('_', '-')}: found {value}, allowed: at least {least:g}")


def single_threaded() -> threadpool_limits:
    """A context in which BLAS runs on one thread."""
    return threadpool_limits(limits=1, user_api="blas")


def pooled(
    function: Callable[[T], R], items: Sequence[T], jobs: int, initialize: Callable[[], object] = single_threaded
) -> Iterator[R]:
    """The results of `function` in the order of `items`, computed by `jobs` processes, with a progress bar.

    `initialize` is called once in each process. One job runs in this process, with BLAS on one thread.
    """
    with tqdm(total=len(items), unit=" runs", disable=None, leave=False) as bar:
        if jobs == 1:
            with single_threaded():
                for item in items:
                    yield function(item)
                    bar.update()
            return
        with ProcessPoolExecutor(jobs, initializer=initialize) as pool:
            for result in pool.map(function, items):
                yield result
                bar.update()


def kept(file: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The figures in a file; if there is none, `make` makes them, and they are written."""
    if file.exists():
        found: dict[str, Any] = json.loads(file.read_text())
        return found
    made = make()
    file.parent.mkdir(parents=True, exist_ok=True)
    aside = file.with_suffix(".partial")
    aside.write_text(json.dumps(made) + "\n")
    aside.replace(file)
    return made


def alternate(inputs: Iterable[T], *functions: Callable[[T], object]) -> Array:
    """(inputs, functions) milliseconds of each function on each input, called in turn: A B A B.

    Alternation spreads the load of other programs evenly over the functions. Compile everything before.
    """
    rows = []
    for value in inputs:
        row = []
        for function in functions:
            began = time.perf_counter()
            function(value)
            row.append(1e3 * (time.perf_counter() - began))
        rows.append(row)
    return np.array(rows)


def machine() -> str:
    """Processor and versions, in one line."""
    info = Path("/proc/cpuinfo")
    rows = info.read_text().splitlines() if info.exists() else []
    models = [row.split(":")[1].strip() for row in rows if row.startswith("model name")]
    processor = f"{len(models)} x {models[0]}" if models else platform.processor() or platform.machine()
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
    return f"{processor}, {versions}, one BLAS thread"


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns; the first row holds the column names."""
    print(text_table(rows, align="right"))


def print_figures(figures: Mapping[str, float], targets: Mapping[str, str]) -> None:
    """Print the machine, then each figure with its target."""
    print(machine())
    head = ("figure", "measured", "target")
    print_table([head, *((key, f"{value:.4g}", targets.get(key, "")) for key, value in figures.items())])


def write_json(file: Path | None, figures: Mapping[str, float]) -> None:
    """Write the figures if a file was given."""
    if file is not None:
        file.write_text(json.dumps(figures, indent=2) + "\n")
