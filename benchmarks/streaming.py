"""Scans fed to `Slam` by hand against the whole loop on the same log: processor time per scan, in turn.

python benchmarks/streaming.py [--rounds 5] [--json FILE]
"""

from __future__ import annotations

import json
import time

import numpy as np
from harness import arguments, machine, run

from sixthsense.config import preset
from sixthsense.core.source import Tick
from sixthsense.loop import replay
from sixthsense.running.warmup import warm_up
from sixthsense.slam.slam import Slam
from sixthsense.sources.logs.log import Log

ESTIMATORS = ("ekf-invariant", "isam2")


def record() -> Log:
    """A tour of 60 s of the apartment as a log."""
    ticks: list[Tick] = []
    run(preset(scene="apartment", task="tour", max_time=60.0), lambda tick, _: ticks.append(tick))
    return Log(ticks)


def by_hand(log: Log, estimator: str) -> float:
    """Milliseconds per scan of scans and odometry fed one by one."""
    config = preset(estimator=estimator)
    began = time.process_time()
    with Slam(config, log.start) as slam:
        for tick in log.ticks:
            if tick.scan is None:
                slam.odometry(tick.stamp_ns, tick.odometry)
            else:
                slam.scan(tick.stamp_ns, tick.scan.ranges, odometry=tick.odometry)
        slam.finish()
    return 1e3 * (time.process_time() - began) / len(log.scans)


def by_loop(log: Log, estimator: str) -> float:
    """Milliseconds per scan of the loop with its record."""
    began = time.process_time()
    replay(log, preset(estimator=estimator))
    return 1e3 * (time.process_time() - began) / len(log.scans)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    warm_up()
    figures = {}
    for estimator in ESTIMATORS:
        log = record()
        rows = np.array([(by_hand(log, estimator), by_loop(log, estimator)) for _ in range(options.rounds)])
        hand, loop = np.median(rows, axis=0)
        ratio = float(np.median(rows[:, 0] / rows[:, 1]))
        print(f"{estimator}: by hand {hand:.3f} ms a scan, loop {loop:.3f} ms, ratio {ratio:.3f}")
        figures[f"{estimator.replace('-', '_')}.ratio"] = ratio
    print(machine())
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
