"""How probable it is that a pose, and that the map, is wrong: logistic models of a few features, fitted to runs.

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
_HARDLY = 0.02  # share contradicted
_MOUNT_M, _MOUNT_RAD = 0.1, 0.05  # of a mount that is off by as much as it may be measured wrong
_BEYOND = 3.0  # sigmas of wheels in general, beyond which wheels and trajectory disagree
OFF_M, OFF_RAD = 0.5, np.radians(10.0)
"""by which a pose is off"""

OF_KEYFRAMES = ("jump", "cut_contradicted", "recent_contradicted", "untied", "old_contradicted")
OF_RUN = ("usual", "cut_peak", "mount", "mount_turned", "mirror", "lag")
KEYFRAME_FEATURES = (*OF_KEYFRAMES, *OF_RUN)
MAP_FEATURES = (*OF_KEYFRAMES, "recent_in_all", "old_in_all", *OF_RUN)
"""of the map: the largest of the keyframes', what is contradicted in all, and those of the run"""


def keyframe_features(found: Evidence) -> Array:
    """(K, 11) of `KEYFRAME_FEATURES`: of each keyframe's last 10 m, and of the run."""
    travel, off = found.travel, found.wheels
    unit = np.array([OFF_M, OFF_M, OFF_RAD])
    sigmas = np.nan_to_num(off.sigmas) / unit
    beyond = np.maximum(np.abs(np.nan_to_num(off.off)) / unit - _BEYOND * sigmas, 0.0)
    jump = np.log1p(sum_over_window(np.sqrt((beyond**2).sum(axis=1)), travel))
    loose = np.clip(1.0 - np.nan_to_num(found.overlap, nan=1.0) / _OVERLAP, 0.0, 1.0)
    contradicted = [share(sum_over_window(each, travel)) for each in (found.recent, found.old)]
    recent, old = (np.sqrt(np.nan_to_num(each)) for each in contradicted)
    untied = np.log1p(sum_over_window(loose * sigmas.max(axis=1), travel))
    own = np.stack([jump, over_window(found.cut, travel), recent, untied, old], axis=1)
    return np.hstack([own, np.broadcast_to(run_features(found), (len(travel), len(OF_RUN)))])


def run_features(found: Evidence) -> Array:
    """(6,) of `OF_RUN`."""
    whitened = found.wheels.whitened
    whitened = whitened[np.isfinite(whitened)]
    usual = np.log1p(np.percentile(whitened, 90)) if len(whitened) else 0.0
    cut = found.cut[np.isfinite(found.cut)]
    # One place that contradicts much more than others, where all of them hardly do.
    peak = np.log((cut.max() + _HARDLY) / (np.percentile(cut, 90) + _HARDLY)) if len(cut) else 0.0
    offset = turned = mirrored = late = 0.0
    if found.mount is not None:
        beyond = np.maximum(np.abs(found.mount.offset) - _BEYOND * found.mount.sigmas, 0.0)
        offset, turned = np.log1p(np.hypot(beyond[0], beyond[1]) / _MOUNT_M), np.log1p(beyond[2] / _MOUNT_RAD)
    if found.mirror is not None:
        mirrored = np.log1p(max(0.0, found.mirror.sigmas - MIRROR_SIGMAS))
    if found.lag is not None:
        late = abs(found.lag.seconds) * max(found.lag.gain, 0.0)
    return np.array([usual, peak, offset, turned, mirrored, late], dtype=np.float64)


def map_features(found: Evidence, keyframes: Array) -> Array:
    """(13,) of `MAP_FEATURES`; `keyframes` (K, 11) are those of the keyframes."""
    count = len(OF_KEYFRAMES)
    largest = keyframes[:, :count].max(axis=0) if len(keyframes) else np.zeros(count)
    in_all = [np.nan_to_num(each).sum(axis=0)[None] for each in (found.recent, found.old)]
    shares = [float(np.sqrt(np.nan_to_num(share(each)))[0]) for each in in_all]
    return np.concatenate([largest, shares, run_features(found)])


@functools.cache
def weights() -> Mapping[str, Any]:
    """The fitted weights: of `keyframes` and of `map`, each with `intercept` and `weights` by feature."""
    text = Path(__file__).with_name("weights.json").read_text(encoding="utf-8")
    found: Mapping[str, Any] = json.loads(text)
    return found


def logistic(model: Mapping[str, Any], names: tuple[str, ...], features: Array) -> Array:
    """(n,) probabilities of features (n, F), columns as `names`."""
    slopes = np.array([model["weights"].get(name, 0.0) for name in names])
    return np.asarray(1.0 / (1.0 + np.exp(-(model["intercept"] + features @ slopes))))
