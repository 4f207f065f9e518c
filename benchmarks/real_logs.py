"""Logs of real robots, replayed with the defaults, and with something taken away or changed.

    SIXTHSENSE_DATA=FOLDER python benchmarks/real_logs.py                          # both logs, defaults
    SIXTHSENSE_DATA=FOLDER python benchmarks/real_logs.py --variants all --jobs 2  # about 20 minutes on two cores
    SIXTHSENSE_DATA=FOLDER python benchmarks/real_logs.py --logs fr079 --variants odometry
    SIXTHSENSE_DATA=FOLDER python benchmarks/real_logs.py --speed                  # the command, bag written

Errors are those of the hand-checked relations (Kümmerle et al. 2009) whose two stamps the variant still has. A variant
changes the evidence (scans left out, another beginning, shorter ranges), the odometry that is assumed, or one parameter
of the front end by a fifth. `--variants` selects those whose name begins so.

`--speed` measures the whole command `sixthsense replay`, start, reading, bag and map included, in a process of its own:
recorded time over its processor time, its largest memory, and the wall time of keyframes, which other work of the
machine lengthens. The ratio is that of the mean keyframe of the last tenth to that of the second.
"""

from __future__ import annotations

import dataclasses
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from harness import Figures, arguments, check_at_least, machine, pooled, print_table, replay, write_json

from sixthsense.config import preset
from sixthsense.core.source import Tick
from sixthsense.evaluation.metrics import relations_error
from sixthsense.figures.run import load
from sixthsense.running.warmup import warm_up, warm_up_scans
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations, has_scan, read_relations
from sixthsense.sources.replay_input import of_log

LOGS = ("intel", "fr079")
Change = Callable[[Sequence[Tick]], Sequence[Tick]]


class Variant(NamedTuple):
    """What is changed of a replay."""

    name: str
    evidence: Change = list
    factors: tuple[tuple[str, str, float], ...] = ()
    """(module, constant, factor) of `sixthsense.slam.scans`"""
    odometry: float = 1.0
    """factor of all sigmas of the odometry"""
    min_score: float = 1.0
    """factor of `scans.min_score`"""
    calibrate_wheels: bool = False


def every_second_scan(ticks: Sequence[Tick]) -> Sequence[Tick]:
    """Leave out the scans with odd numbers; their odometry stays."""
    kept, count = [], 0
    for tick in ticks:
        if tick.scan is not None:
            count += 1
            if count % 2 == 0:
                tick = dataclasses.replace(tick, scan=None, log_stamp_s=None)
        kept.append(tick)
    return kept


def part(first: float, last: float, ticks: Sequence[Tick]) -> Sequence[Tick]:
    """Those between two shares of the log."""
    return ticks[round(first * len(ticks)) : round(last * len(ticks))]


def near(range_m: float, ticks: Sequence[Tick]) -> Sequence[Tick]:
    """Returns beyond a range are no returns."""
    kept = []
    for tick in ticks:
        if tick.scan is not None:
            ranges = np.where(tick.scan.ranges < range_m, tick.scan.ranges, np.float32(math.inf))
            tick = dataclasses.replace(tick, scan=dataclasses.replace(tick.scan, ranges=ranges, max_range=range_m))
        kept.append(tick)
    return kept


STARTS = np.random.default_rng(1000).uniform(0.05, 0.6, 10)
_ODOMETRY = ("_SIGMA_M", "_M_PER_M", "_SIGMA_RAD", "_RAD_PER_RAD", "_RAD_PER_M")
_BY_A_FIFTH = {
    "ambiguity": (("evidence", "_CLEARLY"), ("place_search", "_AS_GOOD")),
    "votes": (("loop_closures", "_VOTE_APART_M"), ("loop_closures", "_VOTE_M")),
    "see-through": (("visibility", "_TOLERANCE_M"),),
    "loss": (("graph", "_RECENT_LOSS"), ("graph", "OLD_LOSS"), ("alignment", "_SCALE_M")),
}
VARIANTS = (
    Variant("defaults"),
    *(
        Variant(f"odometry x {factor:g}", list, tuple(("odometry_prior", n, factor) for n in _ODOMETRY), factor)
        for factor in (2.0, 0.5)
    ),
    Variant("wheels on line", calibrate_wheels=True),
    Variant("every second scan", every_second_scan),
    Variant("half, first", partial(part, 0.0, 0.5)),
    Variant("half, second", partial(part, 0.5, 1.0)),
    Variant("ranges to 8 m", partial(near, 8.0)),
    *(Variant(f"start at {share:.3f}", partial(part, float(share), 1.0)) for share in STARTS),
    *(Variant(f"score x {factor:g}", min_score=factor) for factor in (0.8, 1.2)),
    *(
        Variant(f"{name} x {factor:g}", factors=tuple((module, constant, factor) for module, constant in places))
        for name, places in _BY_A_FIFTH.items()
        for factor in (0.8, 1.2)
    ),
)  # fmt: skip


def figures_of(name: str, variant: Variant) -> Figures:
    """Errors of one replay, and its speed in processor time."""
    folder = Path(os.environ["SIXTHSENSE_DATA"]) / name
    log, relations = open_log(folder / f"{name}.clf.bz2"), read_relations(folder / f"{name}.relations")
    base = preset("log")
    motion = base.assumed.motion
    slip = {f.name: getattr(motion, f.name) for f in dataclasses.fields(motion) if f.name.startswith("slip_")}
    scaled = {key: variant.odometry * value for key, value in slip.items()}
    config = preset(
        "log",
        assumed={"motion": scaled},
        scans={"min_score": variant.min_score * base.scans.min_score},
        calibrate_wheels=variant.calibrate_wheels,
    )
    changed = Log(variant.evidence(log.ticks), log.laser)
    stamps = np.array([t.log_stamp_s for t in changed.ticks if t.log_stamp_s is not None], dtype=np.float64)
    known = has_scan(stamps, relations.stamps).all(axis=1)
    kept = Relations(relations.stamps[known], relations.poses[known])
    with ExitStack() as patched:
        for module, constant, factor in variant.factors:
            place = import_module(f"sixthsense.slam.scans.{module}")
            patched.enter_context(mock.patch.object(place, constant, factor * getattr(place, constant)))
        began = time.process_time()
        trace = replay(changed, of_log(config, log), kept).trace
    spent_s = time.process_time() - began
    errors_m, angles = relations_error(np.array(trace.log_stamps_s), trace.scan_poses(), kept.stamps, kept.poses)
    return {
        "relations": float(len(errors_m)), "mean_m": float(errors_m.mean()), "std_m": float(errors_m.std()),
        "mean_deg": float(np.degrees(angles).mean()), "max_m": float(errors_m.max()),
        "above_0.2_m": float((errors_m > 0.2).sum()), "times_recorded": changed.duration_s / spent_s,
    }  # fmt: skip


def command_figures(name: str) -> Figures:
    """Speed, memory and error of the command `sixthsense replay` with the defaults."""
    folder = Path(os.environ["SIXTHSENSE_DATA"]) / name
    with tempfile.TemporaryDirectory() as out:
        inputs = [str(folder / f"{name}.clf.bz2"), "--relations", str(folder / f"{name}.relations")]
        call = [sys.executable, "-c", "import sys; from sixthsense.cli import main; sys.exit(main())"]
        process = subprocess.Popen([*call, "replay", *inputs, "--out", f"{out}/run"], stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        if status != 0:
            raise RuntimeError(f"replay of {name}: found exit status {status}, allowed: 0")
        run = load(f"{out}/run")
    ms, spent_s = run.trace.stopwatch.keyframe_ms(), used.ru_utime + used.ru_stime
    tenth = max(1, len(ms) // 10)
    return {
        "times_recorded": run.metrics["sim_time_s"] / spent_s, "processor_s": spent_s,
        "keyframe_ms_p50": float(np.percentile(ms, 50)), "keyframe_ms_p99": float(np.percentile(ms, 99)),
        "last_over_second_tenth": float(ms[-tenth:].mean() / ms[tenth : 2 * tenth].mean()),
        "memory_mb": used.ru_maxrss / 1024.0, "mean_m": run.metrics["relations_trans_m_mean"],
    }  # fmt: skip


def print_speed(names: Sequence[str], file: Path | None) -> None:
    """Measure the command on each log, one after the other, with the hot loops compiled."""
    warm_up()
    warm_up_scans()
    found = {name: command_figures(name) for name in names}
    lines = [["log", "x recorded", "processor, s", "keyframe p50, ms", "p99, ms", "last/second tenth", "memory, MB",
              "translation, m"]]  # fmt: skip
    for name, f in found.items():
        lines.append([name, f"{f['times_recorded']:.1f}", f"{f['processor_s']:.1f}", f"{f['keyframe_ms_p50']:.1f}",
                      f"{f['keyframe_ms_p99']:.1f}", f"{f['last_over_second_tenth']:.2f}", f"{f['memory_mb']:.0f}",
                      f"{f['mean_m']:.4f}"])  # fmt: skip
    print(machine())
    print_table(lines)
    write_json(file, {f"{name}.{key}": x for name, f in found.items() for key, x in f.items()})


def _job(due: tuple[str, Variant]) -> Figures:
    return figures_of(*due)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--logs", nargs="+", choices=LOGS, default=LOGS, help="(both)")
    parser.add_argument(
        "--variants", nargs="+", default=["defaults"], metavar="NAME", help="all, or beginnings of names"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (1)")
    parser.add_argument("--speed", action="store_true", help="measure the whole command instead, with the defaults")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1)
    folder = Path(os.environ.get("SIXTHSENSE_DATA", ""))
    if "SIXTHSENSE_DATA" not in os.environ or not all((folder / n / f"{n}.relations").is_file() for n in options.logs):
        print("real_logs.py: SIXTHSENSE_DATA must be a folder with NAME/NAME.clf.bz2 and .relations", file=sys.stderr)
        return 2
    if options.speed:
        print_speed(options.logs, options.json)
        return 0
    chosen = [v for v in VARIANTS if "all" in options.variants or v.name.startswith(tuple(options.variants))]
    if not chosen:
        parser.error(f"--variants: found {options.variants}, allowed: all, {', '.join(v.name for v in VARIANTS)}")
    due = [(name, variant) for name in options.logs for variant in chosen]
    found = list(pooled(_job, due, options.jobs, warm_up))
    lines = [["log", "variant", "relations", "translation, m", "rotation, deg", "largest, m", "> 0.2 m", "x recorded"]]
    for (name, variant), f in zip(due, found, strict=True):
        lines.append([name, variant.name, f"{f['relations']:.0f}", f"{f['mean_m']:.4f} ± {f['std_m']:.4f}",
                      f"{f['mean_deg']:.3f}", f"{f['max_m']:.3f}", f"{f['above_0.2_m']:.0f}",
                      f"{f['times_recorded']:.0f}"])  # fmt: skip
    print(machine())
    print_table(lines)
    write_json(
        options.json, {f"{n}.{v.name}.{key}": x for (n, v), f in zip(due, found, strict=True) for key, x in f.items()}
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
