"""The verdict on maps: fit on runs with right and wrong maps, and judged on others.

    SIXTHSENSE_DATA=FOLDER python benchmarks/verdict.py --runs  # the next runs of both halves; again until none is left
    python benchmarks/verdict.py --fit                          # weights of the package, from the runs of one half
    python benchmarks/verdict.py --keep                         # the tables of the other half, onto the page

A run is wrong if the mean error of its relations is above 0.3 m, or the largest above 2 m. Runs are kept in
`.evidence/verdict`; a part of them begins no run after eight minutes.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import verdict_runs
from harness import CACHE, HERE, arguments, code_commit, finish
from scipy.optimize import minimize

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between
from sixthsense.verdict.evidence import evidence_of
from sixthsense.verdict.judge import judge
from sixthsense.verdict.probability import (
    FEATURES,
    OFF_M,
    OFF_RAD,
    keyframe_features,
    map_features,
    weights,
)
from sixthsense.verdict.verdict import Verdict
from sixthsense.verdict.witnesses import Witnesses

RUNS = CACHE / "verdict"
WEIGHTS = HERE.parent / "sixthsense" / "verdict" / "weights.json"
_PART_S = 480.0
_WRONG_MEAN_M, _WRONG_LARGEST_M = 0.3, 2.0
_BACK_M = 10.0
_PENALTY = 0.001  # of squared weights of features in their standard deviations, to the mean log-likelihood
_HELD, _SILENT = 0.002, -5.0  # the same of intercepts, about that of a feature that says nothing
_BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 1.0)


class Known(NamedTuple):
    """A run, its features, and whether it is wrong."""

    name: str
    damage: str
    found: Witnesses
    keyframes: Array
    """(K, F) features of the keyframes"""
    whole: Array
    """(F,) of the map"""
    is_off: Array
    """(K,) whether each keyframe's pose is off"""
    is_wrong: bool
    mean_m: float
    largest_m: float
    seconds: float
    """processor time of the run, and of the verdict on it"""
    verdict_s: float


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--runs", action="store_true", help="make the next runs")
    parser.add_argument("--fit", action="store_true", help="fit the weights of the package")
    options = parser.parse_args()
    if options.runs:
        make_runs()
        return
    if options.fit:
        write_weights(known_runs("fit"))
    judged = known_runs("judge")
    verdicts = [judge(run.found) for run in judged]
    tables = [of_runs(judged, verdicts), reliability(judged, verdicts), by_damage(judged, verdicts)]
    finish(options, "verdict", *tables)


def make_runs() -> None:
    began, sources = time.monotonic(), {}
    both = [[(half, *job) for job in verdict_runs.jobs(half)] for half in ("fit", "judge")]
    jobs = (job for pair in itertools.zip_longest(*both) for job in pair if job is not None)
    for half, name, front, damage in jobs:
        file = RUNS / half / f"{name}.{front}.{damage}.npz"
        if file.exists():
            continue
        if time.monotonic() - began > _PART_S:
            print("there are more")
            return
        file.parent.mkdir(parents=True, exist_ok=True)
        if name not in sources:
            sources[name] = verdict_runs.source(half, name, RUNS)
        np.savez_compressed(file, **verdict_runs.made(sources[name], front, damage, verdict_runs.SEEDS[half]))


def known_runs(half: str) -> list[Known]:
    """The runs of a half, with their features."""
    found = []
    for file in sorted((RUNS / half).glob("*.npz")):
        with np.load(file) as content:
            arrays = dict(content)
        found.append(known(file, arrays))
    return found


def known(file: Path, arrays: dict[str, Any]) -> Known:
    own, truth = verdict_runs.unpacked(arrays), arrays["truth"]
    truth = truth[np.maximum(own.keys, 0)]
    errors_m, _ = verdict_runs.errors(own.trajectory, truth)
    began = time.process_time()
    evidence = evidence_of(own)
    features = keyframe_features(evidence)
    whole = map_features(evidence, features)
    spent_s = time.process_time() - began
    name, front, damage = file.stem.split(".")
    is_wrong = bool(errors_m.mean() > _WRONG_MEAN_M or errors_m.max() > _WRONG_LARGEST_M)
    off = off_poses(own.trajectory, truth)
    mean_m, largest_m = float(errors_m.mean()), float(errors_m.max())
    return Known(
        f"{name}, {front}", damage, own, features, whole, off, is_wrong, mean_m, largest_m,
        float(arrays["seconds"]), spent_s,
    )  # fmt: skip


def off_poses(poses: Array, truth: Array) -> Array:
    """(K,) whether each pose is off relative to the one 10 m before it, or to the first."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    back = np.searchsorted(way, way - _BACK_M)
    errors = between(between(truth[back], truth), between(poses[back], poses))
    return (np.hypot(errors[:, 0], errors[:, 1]) > OFF_M) | (np.abs(errors[:, 2]) > OFF_RAD)


def write_weights(runs: Sequence[Known]) -> None:
    """Fit both models, and write them with what they were fitted on."""
    share = np.concatenate([np.full(len(run.is_off), 1.0 / len(run.is_off)) for run in runs])
    features, off = np.concatenate([run.keyframes for run in runs]), np.concatenate([run.is_off for run in runs])
    keyframes = fitted(features, off, share, FEATURES)
    whole, wrong = np.array([run.whole for run in runs]), np.array([run.is_wrong for run in runs])
    even = np.where(wrong, 0.5 / wrong.mean(), 0.5 / (~wrong).mean())  # a map is wrong or right with the same prior
    of_map = fitted_any(whole, wrong, even, FEATURES)
    provenance = {
        "fitted by": "python benchmarks/verdict.py --fit", "code": code_commit(),
        "on": "pieces of Intel and fr079, their damages of seed 1, drives in generated worlds",
        "runs": len(runs), "wrong": int(wrong.sum()), "keyframes": len(off), "off": int(off.sum()),
    }  # fmt: skip
    found = {"provenance": provenance, "keyframes": keyframes, "map": of_map}
    WEIGHTS.write_text(json.dumps(found, indent=1) + "\n")
    weights.cache_clear()
    print(json.dumps(found, indent=1))


def fitted(features: Array, wrong: Array, share: Array, names: Sequence[str]) -> dict[str, Any]:
    """Weights of the largest likelihood, each sample by its share, with none that is negative."""
    scale = np.maximum(features.std(axis=0), 1e-9)
    scaled, total = features / scale, share.sum()

    def loss(parameters: Array) -> tuple[float, Array]:
        z = parameters[0] + scaled @ parameters[1:]
        p = 1.0 / (1.0 + np.exp(-z))
        off = share * (p - wrong) / total
        value = float(share @ (np.logaddexp(0.0, z) - wrong * z)) / total + _PENALTY * float(
            parameters[1:] @ parameters[1:]
        )
        return value, np.concatenate([[off.sum()], scaled.T @ off + 2.0 * _PENALTY * parameters[1:]])

    bounds = [(None, None), *[(0.0, None)] * features.shape[1]]
    found = minimize(loss, np.zeros(1 + features.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    slopes = dict(zip(names, (found[1:] / scale).round(4).tolist(), strict=True))
    return {"intercept": round(float(found[0]), 4), "weights": slopes}


def fitted_any(features: Array, wrong: Array, share: Array, names: Sequence[str]) -> dict[str, Any]:
    """The same of a noisy or, whose intercepts are held near that of a feature that says nothing."""
    scale, count = np.maximum(features.std(axis=0), 1e-9), features.shape[1]
    scaled, even = features / scale, share / share.sum()

    def loss(parameters: Array) -> tuple[float, Array]:
        intercepts, slopes = parameters[:count], parameters[count:]
        z = intercepts + scaled * slopes
        hazard = np.logaddexp(0.0, z).sum(axis=1)
        right = np.exp(-hazard)
        is_wrong = np.maximum(1.0 - right, 1e-12)
        by_hazard = even * np.where(wrong, -right / is_wrong, 1.0)
        by_z = by_hazard[:, None] / (1.0 + np.exp(-z))
        value = float(even @ np.where(wrong, -np.log(is_wrong), hazard))
        value += _HELD * float(((intercepts - _SILENT) ** 2).sum()) + _PENALTY * float(slopes @ slopes)
        by_intercepts = by_z.sum(axis=0) + 2.0 * _HELD * (intercepts - _SILENT)
        return value, np.concatenate([by_intercepts, (by_z * scaled).sum(axis=0) + 2.0 * _PENALTY * slopes])

    start = np.concatenate([np.full(count, _SILENT), np.full(count, 0.5)])
    bounds = [(None, 0.0)] * count + [(0.0, None)] * count
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    intercepts, slopes = found[:count], found[count:] / scale
    return {
        "intercepts": dict(zip(names, intercepts.round(4).tolist(), strict=True)),
        "weights": dict(zip(names, slopes.round(4).tolist(), strict=True)),
    }


def of_runs(runs: Sequence[Known], verdicts: Sequence[Verdict]) -> list[list[str]]:
    wrong = np.array([run.is_wrong for run in runs])
    told = np.array([verdict.level != "good" for verdict in verdicts])
    cost = sum(run.verdict_s for run in runs) / sum(run.seconds for run in runs)
    return [
        ["runs not used for fitting", "asked", "measured", "of"],
        ["wrong ones told doubtful or broken", "95 %", f"{100 * told[wrong].mean():.1f} %", str(wrong.sum())],
        ["others told good", "97 %", f"{100 * (~told)[~wrong].mean():.1f} %", str((~wrong).sum())],
        ["processor time of a run", "3 %", f"{100 * cost:.1f} %", str(len(runs))],
    ]


def reliability(runs: Sequence[Known], verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Keyframes by what they were told; the standard error is that over runs."""
    lines = [["told p", "keyframes", "runs", "mean p", "share off", "standard error", "beyond, errors"]]
    for low, high in itertools.pairwise(_BINS):
        sums = []
        for run, verdict in zip(runs, verdicts, strict=True):
            own = (verdict.keyframes >= low) & (verdict.keyframes < high + (high == 1.0))
            if own.any():
                sums.append((own.sum(), run.is_off[own].sum(), verdict.keyframes[own].sum()))
        if not sums:
            continue
        count, off, told = np.array(sums, dtype=np.float64).T
        share, mean = off.sum() / count.sum(), told.sum() / count.sum()
        # Of a ratio over runs, each a cluster of keyframes.
        error = np.sqrt(((off - share * count) ** 2).sum()) / count.sum() * np.sqrt(len(sums) / max(len(sums) - 1, 1))
        beyond = f"{(share - mean) / error:+.1f}" if error else ""
        row = [f"{low:g} to {high:g}", f"{count.sum():,.0f}", str(len(sums)), f"{mean:.3f}", f"{share:.3f}"]
        lines.append([*row, f"{error:.3f}", beyond])
    return lines


def by_damage(runs: Sequence[Known], verdicts: Sequence[Verdict]) -> list[list[str]]:
    lines = [["damage", "wrong", "of these told", "others", "of these told good", "causes told"]]
    for damage in dict.fromkeys(run.damage for run in runs):
        own = [(run, verdict) for run, verdict in zip(runs, verdicts, strict=True) if run.damage == damage]
        wrong = [verdict for run, verdict in own if run.is_wrong]
        right = [verdict for run, verdict in own if not run.is_wrong]
        causes = [verdict.cause for verdict in wrong if verdict.level != "good"]
        counted = ", ".join(f"{causes.count(name)} {name or 'none'}" for name in dict.fromkeys(causes))
        told = sum(verdict.level != "good" for verdict in wrong)
        good = sum(verdict.level == "good" for verdict in right)
        lines.append([damage, str(len(wrong)), str(told), str(len(right)), str(good), counted])
    return lines


if __name__ == "__main__":
    main()
