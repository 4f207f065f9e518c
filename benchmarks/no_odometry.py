"""Scans alone: logs and simulated tours without odometry beside the same with it.

    SIXTHSENSE_DATA=FOLDER python benchmarks/no_odometry.py                          # all, about 15 minutes
    SIXTHSENSE_DATA=FOLDER python benchmarks/no_odometry.py --logs aces --seeds 3

A log's row: relations error, mean and largest, the share beyond 0.5 m, and the share of those beyond 3 sigmas of what
the graph of keyframes says of the relation (for each of its two keyframes relative to the other) and tracking of the
two scans, since their keyframes. A tour's row: ATE and NEES over the seeds.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from harness import arguments, check_at_least, finish

import sixthsense as ss
from sixthsense.config import Config
from sixthsense.core.se2 import compose
from sixthsense.evaluation.metrics import relations_error
from sixthsense.logs.replay_input import open_recorded
from sixthsense.slam.scans.front_end import ScanFrontEnd
from sixthsense.slam.slam import Slam

LOGS = ("fr079", "intel", "aces")
TOURS = ("apartment", "office")
TOUR_S = 120.0


def log_row(name: str, data: Path, no_odometry: bool) -> list[str]:
    """Replay a log; its row."""
    config: Config = ss.preset("log", no_odometry=no_odometry)
    found = open_recorded(data / name / f"{name}.clf.bz2", config, data / name / f"{name}.relations")
    assert found.relations is not None
    stamps: list[float] = []
    keys: list[int] = []
    since: list[np.ndarray] = []
    tracked: dict[float, float] = {}
    with Slam(found.config, found.log.start) as slam:
        front_end, key = slam._front_end, -1
        assert isinstance(front_end, ScanFrontEnd)
        for tick in found.log.ticks:
            step = slam.take(tick)
            key += step.keyframe is not None
            if tick.log_stamp_s is not None:
                stamps.append(tick.log_stamp_s)
                keys.append(key)
                since.append(step.since.motion.array())
                tracked[tick.log_stamp_s] = float(np.linalg.eigvalsh(front_end._since.cov[:2, :2])[-1])
        result = slam.finish()
        motions = np.array(since) if result.since_key is None else result.since_key
        poses = compose(result.trajectory[np.array(keys)], motions)
        off_m, _ = relations_error(np.array(stamps), poses, found.relations.stamps, found.relations.poses)
        far = np.flatnonzero(off_m > 0.5)
        scans = {stamp: k for stamp, k in zip(stamps, keys, strict=True)}
        ends = [[min(scans, key=lambda s: abs(s - at)) for at in found.relations.stamps[k]] for k in far]
        of_keys = [front_end.loop_closures.sigmas(scans[b])[0][scans[a]] for a, b in ends]
        sigmas = [np.sqrt(s**2 + tracked[a] + tracked[b]) for s, (a, b) in zip(of_keys, ends, strict=True)]
    beyond = float(np.mean(off_m[far] > 3.0 * np.array(sigmas))) if len(far) else 0.0
    mode = "scans alone" if no_odometry else "odometry"
    share = len(far) / len(off_m)
    return [name, mode, f"{off_m.mean():.4f}", f"{off_m.max():.2f}", f"{100 * share:.2f} %", f"{100 * beyond:.0f} %"]


def tour_row(scene: str, seeds: int, no_odometry: bool) -> list[str]:
    """Tours of a scene; their row."""
    ate, nees = [], []
    for seed in range(seeds):
        run = ss.run(
            scene, task="tour", seed=seed, max_time=TOUR_S, progress=False,
            front_end="scan-matching", no_odometry=no_odometry,
        )  # fmt: skip
        ate.append(run.metrics["ate_rmse_m"])
        nees.append(run.metrics["pose_nees_world_mean"])
    mode = "scans alone" if no_odometry else "odometry"
    spread = f"{np.min(nees):.2f} to {np.max(nees):.2f}"
    return [f"{scene}, {seeds} seeds", mode, f"{1e3 * np.mean(ate):.1f}", f"{1e3 * np.max(ate):.1f}",
            f"{np.mean(nees):.2f}", spread]  # fmt: skip


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--logs", nargs="*", default=LOGS, choices=LOGS, help="(all)")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="of the tours (10)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    data = os.environ.get("SIXTHSENSE_DATA")
    of_logs = [["log", "motion by", "mean m", "largest m", "beyond 0.5 m", "of these beyond 3 sigmas"]]
    of_logs += [log_row(name, Path(data), without) for name in options.logs for without in (False, True) if data]
    of_tours = [["tour of 120 s", "motion by", "ATE mm", "largest", "NEES (3)", "from, to"]]
    of_tours += [tour_row(scene, options.seeds, without) for scene in TOURS for without in (False, True)]
    finish(options, "no_odometry", of_logs, of_tours, text=2)


if __name__ == "__main__":
    main()
