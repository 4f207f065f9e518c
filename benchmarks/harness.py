"""Shared by the benchmarks: options, timing in alternation, results of many runs, and a table of them.

Runs are made by the engine of campaigns. `finish` prints a table; with `--keep` it becomes a file in `results/`, from
which `tables.py` writes the pages.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock

import numba
import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from sixthsense.campaigns.engine import Processes, carry_out
from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import relations_error
from sixthsense.figures.run import Run, load
from sixthsense.logs.log import Log, Relations
from sixthsense.logs.replay_input import ReplayInput
from sixthsense.loop.run import OnTick
from sixthsense.running.runs import RunHooks, replay_log, simulate

T = TypeVar("T")
R = TypeVar("R")
Figures = dict[str, Any]
"""numbers by name, and of a run its `outcome`"""

HERE = Path(__file__).resolve().parent
CACHE = HERE / ".evidence"
RESULTS = HERE / "results"
EVIDENCE, LOGS = HERE / "evidence.json", HERE / "evidence_logs.json"
PACKAGE = ("sixthsense", "scenes")
"""what the figures of all benchmarks depend on"""


def run(config: Config, *hooks: OnTick) -> Run:
    """Simulate a configuration, without a progress bar."""
    return simulate(config, watch=RunHooks(hooks, progress=False))


def run_by_processor(config: Config) -> Run:
    """The same, with the stages of the loop timed by the processor, for a machine with other work."""
    with mock.patch.object(time, "perf_counter", time.thread_time):  # what the stopwatch of the stages reads
        return run(config)


def replay(log: Log, config: Config, relations: Relations | None = None) -> Run:
    """Replay an open log, without a progress bar."""
    return replay_log(ReplayInput("log", log, config, relations, {}, ()))


def replay_errors(log: Log, config: Config, relations: Relations) -> Figures:
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


def data_path(name: str) -> Path:
    """A file of the real data; one that does not exist where SIXTHSENSE_DATA is not set."""
    return Path(os.environ.get("SIXTHSENSE_DATA", "/nonexistent")) / name


def arguments(description: str | None, may_keep: bool = True) -> argparse.ArgumentParser:
    """A parser with the option that every benchmark has whose table is on a page."""
    parser = argparse.ArgumentParser(description=(description or "").split("\n\n")[0])
    if may_keep:
        parser.add_argument(
            "--keep", action="store_true", help="keep the table in results/, and write it into the pages"
        )
    return parser


def git(*words: str) -> str:
    """What git says of this repository; RuntimeError in one line where it fails."""
    done = subprocess.run(["git", *words], cwd=HERE.parent, capture_output=True, text=True)
    if done.returncode:
        said = "".join(done.stderr.strip().splitlines()[-1:]) or "failed"
        raise RuntimeError(f"git {words[0]}: {said}, allowed: a clone of the repository, and a commit of it")
    return done.stdout


def commit_of(revision: str) -> str:
    """The full name of a commit; RuntimeError for a name that is not of one."""
    return git("rev-parse", "--verify", f"{revision}^{{commit}}").strip()


def unpack(commit: str, folder: Path) -> None:
    """Write the tree of a commit into a new folder."""
    archive = subprocess.run(["git", "archive", commit], cwd=HERE.parent, check=True, capture_output=True)
    folder.mkdir(parents=True)
    subprocess.run(["tar", "-x"], cwd=folder, check=True, input=archive.stdout)


@contextlib.contextmanager
def trees(revision: str) -> Iterator[tuple[Path, Path]]:
    """The tree that is worked on, and that of a commit as long as the block lasts."""
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder) / "tree"
        unpack(commit_of(revision), base)
        yield HERE.parent, base


def environment(tree: Path) -> dict[str, str]:
    """The environment in which Python imports the package of a tree."""
    return os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}


def printed(tree: Path, program: str, *words: str, **more: str) -> Figures:
    """What a program prints in its last line, run with the package of a tree; `more` is set in its environment."""
    call = [sys.executable, "-c", program, *words]
    done = subprocess.run(call, cwd=tree, env=environment(tree) | more, capture_output=True, text=True, check=True)
    figures: Figures = json.loads(done.stdout.splitlines()[-1])
    return figures


def code_commit(code: Sequence[str] = PACKAGE) -> str:
    """The last commit that changed the code, with a hash of what is not committed; RuntimeError outside a clone."""
    changed = git("diff", "HEAD", "--", *code)
    commit = git("log", "-1", "--format=%h", "--abbrev=10", "--", *code).strip()
    return f"{commit}+{hashlib.sha256(changed.encode()).hexdigest()[:6]}" if changed else commit


def mean_and_error(values: list[float]) -> tuple[float, float | None]:
    """Mean over runs and its standard error; None for one run."""
    given = np.array(values, dtype=np.float64)
    error = float(given.std(ddof=1) / np.sqrt(len(given))) if len(given) > 1 else None
    return float(given.mean()), error


def rows_as_json(rows: Mapping[str, Any]) -> str:
    """JSON with a row per line."""
    lines = ",\n".join(f"  {json.dumps(key)}: {json.dumps(row)}" for key, row in rows.items())
    return f'{{\n "rows": {{\n{lines}\n }}\n}}\n'


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
) -> list[R]:
    """The results of `function` in the order of `items`, computed by `jobs` processes, with a progress bar.

    `initialize` is called once in each process.
    """
    named = {str(k): item for k, item in enumerate(items)}
    with Processes(jobs, initialize) as pool, tqdm(total=len(items), unit=" runs", disable=None, leave=False) as bar:
        found: dict[str, R] = {}
        for key, future in carry_out(pool, function, named):
            found[key] = future.result()
            bar.update()
    return [found[key] for key in named]


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
    import pandas as pd

    print(pd.DataFrame(rows[1:], columns=rows[0]).to_string(index=False))


def write_pages() -> None:
    """Write the tables of the pages anew."""
    subprocess.run([sys.executable, HERE / "tables.py"], check=True)


def finish(options: argparse.Namespace, name: str, *tables: Sequence[Sequence[str]], text: int = 1) -> None:
    """Print the machine and the tables, whose first `text` columns are words; with `--keep`, keep them as `name`."""
    print(machine())
    for table in tables:
        print_table(table)
    if options.keep:
        command = " ".join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]]).replace(" --keep", "")
        found = {"command": command, "commit": code_commit(), "machine": machine(), "text": text, "tables": tables}
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / f"{name}.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")
        write_pages()


def against_limits(figures: Mapping[str, float], limits: Mapping[str, str]) -> list[list[str]]:
    """A table of figures beside their limits, such as "<= 0.2", and whether each is met."""
    lines = [["figure", "measured", "limit", "met"]]
    for key, value in figures.items():
        limit = limits.get(key, "")
        sign, _, number = limit.partition(" ")
        is_met = limit and (value <= float(number) if sign == "<=" else value >= float(number))
        lines.append([key, f"{value:.4g}", limit, "yes" if is_met else "NO" if limit else ""])
    return lines
