"""A campaign of 40 short runs: speed with one and two workers, local and by a scheduler, and with a killed worker."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import psutil
from harness import Figures, arguments, print_figures, write_json

from sixthsense.campaigns import load_campaign
from sixthsense.running.warmup import warm_up

RUNS = 40
COMMAND = ("campaign", "apartment", "--seeds", f"0:{RUNS}", "--task", "tour")
TIMED = ("run_time_s", "wall_time_s", "realtime_factor", "scan_ms", "stage_ms", "host")

TARGETS = {
    "local.2_over_1": ">= 1.7",
    "by_hand.2_over_1": ">= 1.7",
    "killed.rows": f"{RUNS}",
    "killed.twice": "0",
    "killed.by_hand.rows": f"{RUNS}",
    "killed.by_hand.twice": "0",
    "differing_rows": "0",
}


def start(out: Path, max_time: float, *options: str) -> subprocess.Popen[bytes]:
    """Start the campaign as a process."""
    words = [*COMMAND, "--max-time", str(max_time), "--out", str(out), *options]
    return subprocess.Popen(
        [sys.executable, "-m", "sixthsense.cli", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def end(campaign: subprocess.Popen[bytes]) -> None:
    _, err = campaign.communicate()
    if campaign.returncode != 0:
        raise SystemExit(f"exit code {campaign.returncode}: {err.decode()}")


def speed(name: str, workers: int, out: Path, max_time: float, *options: str) -> Figures:
    """Runs per hour over the whole command, and the share of its time that the workers spent in runs.

    The load of other programs lowers the former; the campaign's own overhead (start, warm-up, rows) lowers the latter.
    """
    began = time.perf_counter()
    end(start(out, max_time, *options))
    elapsed_s = time.perf_counter() - began
    busy = load_campaign(out).frame()["run_time_s"].sum() / (workers * elapsed_s)
    return {f"{name}.{workers}.runs_per_hour": 3600.0 * RUNS / elapsed_s, f"{name}.{workers}.busy": busy}


@contextlib.contextmanager
def by_hand(workers: int) -> Iterator[str]:
    """The address of a scheduler with workers, started as processes like in Dask's documentation."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [str(Path(sys.executable).with_name("dask"))]
    lines = [[*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]]
    lines += [[*dask, "worker", address, "--nthreads", "1", "--no-dashboard"]] * workers
    with contextlib.ExitStack() as stack:
        for line in lines:
            program = stack.enter_context(subprocess.Popen(line, stderr=subprocess.DEVNULL))
            stack.callback(program.terminate)
            time.sleep(3.0)
        yield address


def kill_one(programs: list[psutil.Process], out: Path) -> None:
    """Kill a worker process with SIGKILL once a third of the rows is written."""
    while len(list((out / "rows").glob("run-*"))) < RUNS // 3:
        time.sleep(0.1)
    workers = [p for program in programs for p in program.children(recursive=True) if "spawn_main" in str(p.cmdline())]
    os.kill(workers[0].pid, signal.SIGKILL)


def rows(out: Path, name: str) -> Figures:
    frame = load_campaign(out).frame()
    twice = len(frame) - frame[["scene", "estimator", "preset", "planner", "seed"]].drop_duplicates().shape[0]
    errors = (frame["outcome"] == "error").sum()
    return {f"{name}.rows": len(frame), f"{name}.twice": twice, f"{name}.errors": int(errors)}


def measured(out: Path) -> pd.DataFrame:
    """The table without measured times: all else is reproducible on any worker."""
    frame = load_campaign(out).frame()
    return frame[[name for name in frame.columns if not name.startswith(TIMED)]]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--max-time", type=float, default=120.0, metavar="S", help="simulated seconds of each run")
    options = parser.parse_args()
    warm_up()
    figures: Figures = {"load.before": os.getloadavg()[0]}
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        outs = [home / name for name in ("one", "two", "hand-one", "hand-two", "killed", "hand-killed")]
        for count, out in ((1, outs[0]), (2, outs[1])):
            figures |= speed("local", count, out, options.max_time, "--workers", str(count))
        figures["local.2_over_1"] = figures["local.2.runs_per_hour"] / figures["local.1.runs_per_hour"]
        for count, out in ((1, outs[2]), (2, outs[3])):
            with by_hand(count) as address:
                figures |= speed("by_hand", count, out, options.max_time, "--scheduler", address)
        figures["by_hand.2_over_1"] = figures["by_hand.2.runs_per_hour"] / figures["by_hand.1.runs_per_hour"]
        campaign = start(outs[4], options.max_time, "--workers", "2")
        kill_one([psutil.Process(campaign.pid)], outs[4])
        end(campaign)
        figures |= rows(outs[4], "killed")
        with by_hand(2) as address:
            campaign = start(outs[5], options.max_time, "--scheduler", address)
            mine = [p for p in psutil.Process().children() if p.pid != campaign.pid]
            kill_one(mine, outs[5])
            end(campaign)
        figures |= rows(outs[5], "killed.by_hand")
        first, *others = map(measured, outs)
        figures["differing_rows"] = sum(
            int((~((first == other) | (first.isna() & other.isna())).all(axis=1)).sum()) for other in others
        )
    figures["load.after"] = os.getloadavg()[0]
    print_figures(figures, TARGETS)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
