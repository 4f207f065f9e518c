"""How probable it is that a pose, and that the map, is wrong: models of a few features, fitted to runs.

Of a keyframe the model is logistic. A map can be wrong in many ways, each of which is enough: it is right if it is in
none of them, each a logistic function of one feature (a noisy or: Pearl 1988, Probabilistic Reasoning, section 4.3).
Each feature is 0 where nothing is suspicious or nothing is known, and grows with what is. No weight is negative: more
evidence against a map never makes it better. `benchmarks/verdict.py` fits the weights; `weights.json` says on what.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.verdict.evidence import Evidence, over_window, share, sum_over_window

MIRROR_SIGMAS = 4.0
"""by which a mirror wins more often than by chance: in sixteen turns of sixteen"""
_OVERLAP = 0.5  # share of a scan's returns that those before confirm, below which it is not well tied to them
_LEAST_SIGMA = 0.05  # of a slope of turns
_MOUNT_M, _MOUNT_RAD = 0.1, 0.05  # of a mount that is off by as much as it may be measured wrong
_BEYOND = 3.0  # sigmas of wheels in general, beyond which wheels and trajectory disagree
OFF_M, OFF_RAD = 0.5, np.radians(10.0)
"""by which a pose is off"""

OF_KEYFRAMES, OF_RUN = ("cut", "recent", "untied", "old"), ("mount", "mount_turned", "mirror")
FEATURES = (*OF_KEYFRAMES, *OF_RUN)
"""names of the features, of keyframes and of the map"""


def keyframe_features(found: Evidence) -> Array:
    """(K, 7) of `FEATURES`: what is contradicted and what is not tied on each keyframe's last 10 m, and of the run."""
    travel, sigmas = found.travel, np.nan_to_num(found.wheels.sigmas) / (OFF_M, OFF_M, OFF_RAD)
    loose = np.clip(1.0 - np.nan_to_num(found.overlap, nan=1.0) / _OVERLAP, 0.0, 1.0)
    recent, old = (np.sqrt(np.nan_to_num(share(sum_over_window(each, travel)))) for each in (found.recent, found.old))
    untied = -np.expm1(-sum_over_window(loose * sigmas.max(axis=1), travel))
    own = np.stack([over_window(found.cut, travel), recent, untied, old], axis=1)
    return np.hstack([own, np.broadcast_to(run_features(found), (len(travel), len(OF_RUN)))])


def run_features(found: Evidence) -> Array:
    """(3,) of `OF_RUN`."""
    offset = turned = sigmas = 0.0
    if found.mount is not None:
        beyond = np.maximum(np.abs(found.mount.offset) - _BEYOND * found.mount.sigmas, 0.0)
        offset, turned = np.log1p(np.hypot(beyond[0], beyond[1]) / _MOUNT_M), np.log1p(beyond[2] / _MOUNT_RAD)
    if found.mirror is not None:
        sigmas = found.mirror.sigmas
    if found.turns is not None:
        sigmas = max(sigmas, -found.turns.slope / max(found.turns.sigma, _LEAST_SIGMA))
    return np.array([offset, turned, np.log1p(max(0.0, sigmas - MIRROR_SIGMAS))], dtype=np.float64)


def map_features(found: Evidence, keyframes: Array) -> Array:
    """(7,) of `FEATURES`: the largest of the keyframes' (K, 7), and what scans contradict in all.

    Those of other passes beyond what scans of one pass contradict of each other, and these beyond what successive scans
    do: people and a bad laser are no evidence against walls.
    """
    largest = keyframes.max(axis=0, initial=0.0)
    old, recent = (share(np.nansum(each, axis=0)[None])[0] for each in (found.old, found.recent))
    largest[OF_KEYFRAMES.index("old")] = np.sqrt(np.fmax(old - recent, 0.0))
    largest[OF_KEYFRAMES.index("recent")] = np.sqrt(max(found.bends, 0.0))
    return np.asarray(largest)


@functools.cache
def weights() -> Mapping[str, Any]:
    """The fitted weights by feature: of `keyframes`, with an `intercept`, and of `map`, with `intercepts`."""
    text = Path(__file__).with_name("weights.json").read_text(encoding="utf-8")
    found: Mapping[str, Any] = json.loads(text)
    return found


def logistic(model: Mapping[str, Any], names: tuple[str, ...], features: Array) -> Array:
    """(n,) probabilities of features (n, F), columns as `names`."""
    slopes = np.array([model["weights"].get(name, 0.0) for name in names])
    return np.asarray(1.0 / (1.0 + np.exp(-(model["intercept"] + features @ slopes))))


def noisy_or(model: Mapping[str, Any], names: tuple[str, ...], features: Array) -> Array:
    """(n,) the same where any of the features is enough, each by an intercept and a weight of its own."""
    intercepts, slopes = (np.array([model[part][name] for name in names]) for part in ("intercepts", "weights"))
    return np.asarray(-np.expm1(-np.logaddexp(0.0, intercepts + slopes * features).sum(axis=1)))
