"""Processor time of logs and explorations, beside an earlier commit and MRPT: what `kernels.py --logs REV` prints.

MRPT's `icp-slam` is measured where it is installed: `apt-get install mrpt-apps` on Debian 12. It aligns every scan with
a map of points, from its odometry, without loop closures; `carmen2rawlog` converts the log, which does not count. With
the settings below it keeps its place on Freiburg 079 and loses it on Intel and ACES.
"""

from __future__ import annotations

import bz2
import json
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from harness import HERE, Figures, data_path, environment, printed, trees

from sixthsense.evaluation.metrics import relations_error
from sixthsense.logs import open_log
from sixthsense.logs.log import read_relations

LOGS = {"intel": 16.0, "fr079": 10.0, "aces": 10.0}
"""processor time to reach, s"""
EXPLORED = {"ekf-invariant": 90.0, "isam2": 55.0}
"""times real time to reach, in the apartment"""
P99_MS, FIRST_S = 8.0, 30.0
ROUNDS = 2
"""of each run in both trees, in turn; the least time of them counts"""

_ICP = """
[MappingApplication]
rawlog_offset = 0
logOutput_dir = {out}
LOG_FREQUENCY = 100000000
SAVE_3D_SCENE = 0
SAVE_POSE_LOG = 1
CAMERA_3DSCENE_FOLLOWS_ROBOT = 0
SHOW_PROGRESS_3D_REAL_TIME = 0
SHOW_PROGRESS_3D_REAL_TIME_DELAY_MS = 0
SHOW_LASER_SCANS_3D = 0
matchAgainstTheGrid = 0
localizationLinDistance = 0
localizationAngDistance = 0
insertionLinDistance = 1.0
insertionAngDistance = 30.0
minICPgoodnessToAccept = 0.40
pointsMap_count = 1
occupancyGrid_count = 0
[MappingApplication_pointsMap_00_insertOpts]
minDistBetweenLaserPoints = 0.05
[ICP]
ICP_algorithm = icpClassic
maxIterations = 80
minAbsStep_trans = 1e-6
minAbsStep_rot = 1e-6
thresholdDist = 0.3
thresholdAng_DEG = 0.15
ALFA = 0.8
smallestThresholdDist = 0.05
onlyClosestCorrespondences = true
corresponding_points_decimation = 5
"""

_COMMAND = "import sys; from sixthsense.cli import main; sys.exit(main())"

# The loop's clock is that of the processor.
_EXPLORE = """
import json, pathlib, sys, tempfile, time
time.perf_counter = time.thread_time
import sixthsense as ss

for scene, limits in (("rectangle", {"task": "tour", "max_time": 1.0}), ("apartment", {"task": "explore"})):
    with tempfile.TemporaryDirectory() as folder:
        run = ss.run(scene, out=pathlib.Path(folder) / "run", progress=False, estimator=sys.argv[1], **limits)
factor = run.metrics["sim_time_s"] / run.trace.wall_time_s
print(json.dumps({"factor": factor, "ms": run.trace.stopwatch.keyframe_ms().tolist()}))
"""

_FIRST = """
import json, time
import sixthsense as ss

begun = []
ss.run("rectangle", task="tour", max_time=1.0, progress=False, on_tick=lambda *_: begun.append(time.process_time()))
print(json.dumps({"first_s": begun[1]}))
"""


def logs_tables(revision: str) -> tuple[list[list[str]], list[list[str]]]:
    """Tables of this tree beside the commit `revision`, and beside MRPT."""
    with tempfile.TemporaryDirectory() as folder, trees(revision) as both:
        first = [printed(tree, _FIRST, NUMBA_CACHE_DIR=f"{folder}/{k}")["first_s"] for k, tree in enumerate(both)]
        for tree in both:  # its kernels are compiled
            _command_s(tree, "aces", folder)
            printed(tree, _EXPLORE, "isam2")
        logs = {log: _in_turn(lambda tree, log=log: _command_s(tree, log, folder), both) for log in LOGS}
        rows = [(f"{log}, whole command, s", logs[log], f"<= {most:g}") for log, most in LOGS.items()]
        p99 = [np.inf, np.inf]
        for estimator, least in EXPLORED.items():
            found = [[printed(tree, _EXPLORE, estimator) for tree in both] for _ in range(ROUNDS)]
            best = [max(turn[k]["factor"] for turn in found) for k in range(2)]
            rows.append((f"apartment explored, `{estimator}`, times real time", best, f">= {least:g}"))
            if estimator == "ekf-invariant":
                p99 = [min(float(np.percentile(turn[k]["ms"], 99)) for turn in found) for k in range(2)]
        rows.append(("keyframe of it, p99, ms", p99, f"<= {P99_MS:g}"))
        rows.append(("first run in a fresh environment, of its first process, s", first, f"<= {FIRST_S:g}"))
        peers = [["log", "ours, s", "error, m", "`icp-slam`, s", "error, m"]]
        for log in LOGS:
            with_mrpt = _mrpt(log) if shutil.which("icp-slam") and shutil.which("carmen2rawlog") else {}
            ours = json.loads((Path(folder) / f"{log}.json").read_text())
            cells = [logs[log][0], ours["relations_trans_m_mean"], with_mrpt.get("spent_s"), with_mrpt.get("mean_m")]
            peers.append([log, *("" if x is None else f"{x:.3g}" for x in cells)])
    head = ["processor time", "measured", f"at {revision}", "ratio", "to reach"]
    return [head, *([what, f"{a:.3g}", f"{b:.3g}", f"{a / b:.2f}", to] for what, (a, b), to in rows)], peers


def _in_turn(spent_s: Callable[[Path], float], both: Sequence[Path]) -> list[float]:
    """The least time of each tree."""
    return np.min([[spent_s(tree) for tree in both] for _ in range(ROUNDS)], axis=0).tolist()


def _command_s(tree: Path, log: str, folder: str) -> float:
    """Processor time of `sixthsense replay`, s; the metrics of this tree's run are kept in `folder`."""
    words = ["replay", str(data_path(f"{log}/{log}.clf.bz2")), "--relations", str(data_path(f"{log}/{log}.relations"))]
    out = Path(folder) / f"{tree.name}.{log}"
    call = [sys.executable, "-c", _COMMAND, *words, "--out", str(out), "--overwrite"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(call, cwd=tree, env=environment(tree), check=True, capture_output=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    if tree == HERE.parent:
        shutil.copy(out / "metrics.json", Path(folder) / f"{log}.json")
    return used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime


def _mrpt(log: str) -> Figures:
    """Processor time of `icp-slam` with every scan of a log, s, and its mean error, m."""
    file, relations = data_path(f"{log}/{log}.clf.bz2"), read_relations(data_path(f"{log}/{log}.relations"))
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        (at / "in.log").write_bytes(bz2.decompress(file.read_bytes()))
        (at / "in.ini").write_text(_ICP.format(out=at / "out"))
        quiet = {"check": True, "capture_output": True, "stdin": subprocess.DEVNULL}
        subprocess.run(["carmen2rawlog", "-q", "-w", "-i", at / "in.log", "-o", at / "in.rawlog"], **quiet)  # type: ignore[call-overload]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        subprocess.run(["icp-slam", at / "in.ini", at / "in.rawlog"], **quiet)  # type: ignore[call-overload]
        spent_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        poses = np.loadtxt(at / "out" / "log_estimated_path.txt")[1::2, 1:4]  # a step of odometry, then one of a scan
    stamps = np.array([tick.log_stamp_s for tick in open_log(file).ticks if tick.log_stamp_s is not None])
    if len(stamps) != len(poses):
        raise RuntimeError(f"icp-slam: found {len(poses)} poses, allowed: {len(stamps)}, one for each scan")
    errors_m, _ = relations_error(stamps, poses, relations.stamps, relations.poses)
    return {"spent_s": spent_s, "mean_m": float(errors_m.mean())}
