"""Speed of whole runs and of their start, beside an earlier commit: what `kernels.py --loop REV` prints."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import printed, trees

SCENES = ("rectangle", "block", "apartment", "office", "loop")
ROUNDS = 3
"""of each run in both trees, in turn; the least time of them counts, which the load of the machine hardly feels"""

# A process of its own tree; what both commits have alone is used.
_RUN = """
import json, pathlib, sys, tempfile, time
import sixthsense as ss

scene, changes = sys.argv[1], json.loads(sys.argv[2])
begun = []

def begin(tick, trace):
    begun.append(time.process_time())

ss.run("rectangle", task="tour", max_time=1.0, estimator=changes["estimator"], progress=False, on_tick=begin)
with tempfile.TemporaryDirectory() as folder:
    out = pathlib.Path(folder) / "run" if changes.pop("is_kept") else None
    before = time.process_time()
    run = ss.run(scene, out=out, progress=False, **changes)
    spent_s = time.process_time() - before
print(json.dumps({"start_s": begun[1], "spent_s": spent_s, "ms": run.trace.stopwatch.keyframe_ms().tolist()}))
"""

_CAMPAIGN = """
import json, pathlib, sys, tempfile, time
import sixthsense as ss

if __name__ == "__main__":
    count = 16
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        ss.campaign("apartment", seeds=range(count), estimator="ekf-invariant", task="tour", max_time=200.0,
                    out=pathlib.Path(folder) / "runs", workers=2, progress=False)
        print(json.dumps({"hourly": 3600.0 * count / (time.perf_counter() - begun)}))
"""


def loop_table(revision: str) -> list[list[str]]:
    """A table of runs on this tree, on the commit `revision`, and their ratio."""
    with trees(revision) as both:
        for tree in both:  # its kernels are compiled
            for estimator in ("ekf-invariant", "isam2"):
                _run(tree, "apartment", estimator=estimator, task="explore", max_time=10.0)
        rows = _rows(both)
    head = ["what", "measured", f"at {revision}", "ratio", "to reach"]
    return [
        head,
        *([name, *(f"{x:.3g}" for x in (ours, before, ours / before)), to] for name, ours, before, to in rows),
    ]


def _rows(trees: Sequence[Path]) -> list[tuple[str, float, float, str]]:
    """Per row: what it is, the figure of this tree and of the other, and what is asked of it."""
    rows, starts = [], [np.inf, np.inf]
    for estimator, to_reach in (("ekf-invariant", "ratio 0.5"), ("isam2", "ratio 0.65")):
        found = _alternated(trees, "apartment", is_kept=True, estimator=estimator, task="explore")
        rows.append((f"apartment explored, bag written, `{estimator}`, s", *_least(found, "spent_s"), to_reach))
    found = _alternated(trees, "rectangle", estimator="ekf-invariant", task="tour", max_time=200.0)
    rows.append(("tour of 200 s, nothing written, s", *_least(found, "spent_s"), "ratio 0.5"))
    ms: list[list[float]] = [[], []]
    for scene in SCENES:
        found = _alternated(trees, scene, rounds=1, estimator="ekf-invariant", task="tour", max_time=60.0)
        for k in range(2):
            ms[k] += found[k][0]["ms"]
            starts[k] = min(starts[k], found[k][0]["start_s"])
    for percent, to_reach in ((50, "2 ms"), (99, "8 ms")):
        ours, before = (float(np.percentile(each, percent)) for each in ms)
        rows.append((f"keyframe of five scenes, p{percent}, ms", ours, before, to_reach))
    rows.append(("from the start of the process to the first motion, s", *starts, "1.1 s"))
    hourly = [max(printed(tree, _CAMPAIGN)["hourly"] for _ in range(2)) for tree in trees]
    rows.append(("tours of 200 s by a campaign of 16 on two cores, an hour", hourly[0], hourly[1], "ratio 2"))
    return rows


def _least(found: Sequence[Sequence[dict[str, Any]]], key: str) -> tuple[float, float]:
    ours, before = (min(row[key] for row in rows) for rows in found)
    return ours, before


def _alternated(
    trees: Sequence[Path], scene: str, rounds: int = ROUNDS, **changes: object
) -> list[list[dict[str, Any]]]:
    """Figures of runs in each of the trees, made in turn."""
    found: list[list[dict[str, Any]]] = [[] for _ in trees]
    for _ in range(rounds):
        for tree, rows in zip(trees, found, strict=True):
            rows.append(_run(tree, scene, **changes))
    return found


def _run(tree: Path, scene: str, **changes: object) -> dict[str, Any]:
    """Figures of a run of a scene in a process of its own: s of processor time, and ms of each keyframe."""
    return printed(tree, _RUN, scene, json.dumps({"is_kept": False} | changes))
