"""The verdict on maps: its weights, fitted on runs with right and wrong maps, and how it judges others.

    SIXTHSENSE_DATA=FOLDER python benchmarks/verdict.py    # makes the runs of one half, and fits the weights; resumes

A run is wrong if the mean error of its relations is above 0.3 m, or the largest above 2 m. Runs are kept in
`.evidence/verdict`.
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
from runs import Figures, Setting
from scipy.optimize import minimize

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between
from sixthsense.verdict.evidence import evidence_of
from sixthsense.verdict.judge import judge
from sixthsense.verdict.probability import FEATURES, OFF_M, OFF_RAD, keyframe_features, map_features, weights
from sixthsense.verdict.witnesses import Witnesses

HERE = Path(__file__).resolve().parent
RUNS = HERE / ".evidence" / "verdict"
WEIGHTS = HERE.parent / "sixthsense" / "verdict" / "weights.json"
_WRONG_MEAN_M, _WRONG_LARGEST_M = 0.3, 2.0
_BACK_M = 10.0
_PENALTY = 0.001  # of squared weights of features in their standard deviations, to the mean log-likelihood
_HELD, _SILENT = 0.002, -5.0  # the same of intercepts, about that of a feature that says nothing
BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 1.0)


class Known(NamedTuple):
    """A run, its features, and whether it is wrong."""

    found: Witnesses
    keyframes: Array
    """(K, F) features of the keyframes"""
    whole: Array
    """(F,) of the map"""
    is_off: Array
    """(K,) whether each keyframe's pose is off"""
    is_wrong: bool
    seconds: float
    """processor time of the run, and of the verdict on it"""
    verdict_s: float


def main() -> None:
    """Make the runs of the half that is fitted, and fit."""
    write_weights([known(made_run("fit", *job)) for job in verdict_runs.jobs("fit")])


def made_run(half: str, name: str, front: str, damage: str) -> Path:
    """The file of a run, which is made if it is not there."""
    file = RUNS / half / f"{name}.{front}.{damage}.npz"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        source = verdict_runs.source(half, name, RUNS)
        np.savez_compressed(file, **verdict_runs.made(source, front, damage, verdict_runs.SEEDS[half]))
    return file


def judged(setting: Setting, seed: int) -> Figures:
    """How many runs with a damage are wrong, and are told so."""
    runs = [known(made_run("judge", *job)) for job in verdict_runs.jobs("judge") if job[2] == setting[0]]
    is_good = np.array([judge(run.found).level == "good" for run in runs])
    wrong = np.array([run.is_wrong for run in runs])
    return {
        "wrong": wrong.sum(), "told": (wrong & ~is_good).sum(), "right": (~wrong).sum(),
        "good": (is_good & ~wrong).sum(), "run_s": sum(run.seconds for run in runs),
        "verdict_s": sum(run.verdict_s for run in runs),
    }  # fmt: skip


def reliability(setting: Setting, seed: int) -> Figures:
    """Keyframes of all judged runs by what they were told: their mean probability, the share that is off, its error.

    The standard error is of a ratio over runs, each a cluster of keyframes.
    """
    runs = [known(made_run("judge", *job)) for job in verdict_runs.jobs("judge")]
    told, found = [judge(run.found).keyframes for run in runs], Figures()
    for k, (low, high) in enumerate(itertools.pairwise(BINS)):
        own = [(each >= low) & (each < high + (high == 1.0)) for each in told]
        count, off, p = (
            np.array([values[mask].sum() for values, mask in zip(each, own, strict=True)], dtype=np.float64)
            for each in ([np.ones(len(one)) for one in told], [run.is_off for run in runs], told)
        )
        if count.any():
            share = off.sum() / count.sum()
            error = np.sqrt(((off - share * count) ** 2).sum() * len(runs) / max(len(runs) - 1, 1)) / count.sum()
            found |= {f"p_{k}": p.sum() / count.sum(), f"share_{k}": share, f"error_{k}": error}
    return found


def known(file: Path) -> Known:
    """A run that was kept, with its features."""
    with np.load(file) as content:
        arrays: dict[str, Any] = dict(content)
    own, truth = verdict_runs.unpacked(arrays), arrays["truth"]
    truth = truth[np.maximum(own.keys, 0)]
    errors_m, _ = verdict_runs.errors(own.trajectory, truth)
    began = time.process_time()
    evidence = evidence_of(own)
    features = keyframe_features(evidence)
    whole = map_features(evidence, features)
    spent_s = time.process_time() - began
    is_wrong = bool(errors_m.mean() > _WRONG_MEAN_M or errors_m.max() > _WRONG_LARGEST_M)
    off = off_poses(own.trajectory, truth)
    return Known(own, features, whole, off, is_wrong, float(arrays["seconds"]), spent_s)


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
        "fitted by": "python benchmarks/verdict.py",
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


if __name__ == "__main__":
    main()
