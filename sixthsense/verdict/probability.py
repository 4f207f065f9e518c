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
from sixthsense.verdict.views import FEWEST, SURFACE

MIRROR_SIGMAS = 4.0
"""by which a mirror wins more often than by chance: in sixteen turns of sixteen"""
_BEYOND = 3.0  # sigmas of wheels in general, beyond which wheels and trajectory disagree
OFF_M, OFF_RAD = 0.5, np.radians(10.0)
"""by which a pose is off"""

KEYFRAME_FEATURES = ("jump", "step_contradicted", "recent_contradicted", "untied", "old_contradicted", "usual")
MAP_FEATURES = (
    "jump", "step_contradicted", "recent_contradicted", "untied", "old_contradicted", "worst_old", "usual", "mount",
    "mirror", "lag",
)  # fmt: skip


def keyframe_features(found: Evidence) -> Array:
    """(K, 6) of `KEYFRAME_FEATURES`, of each keyframe's last 10 m."""
    travel, off = found.travel, found.wheels
    sigmas = np.nan_to_num(off.sigmas)
    worth = (off.off / (OFF_M, OFF_M, OFF_RAD)), sigmas / (OFF_M, OFF_M, OFF_RAD)
    beyond = np.maximum(np.abs(np.nan_to_num(worth[0])) - _BEYOND * worth[1], 0.0)
    jump = np.log1p(sum_over_window(np.sqrt((beyond**2).sum(axis=1)), travel))
    held = np.nan_to_num(found.recent[:, SURFACE], nan=np.inf)
    loose = np.clip(1.0 - held / FEWEST, 0.0, 1.0)
    loose[:1] = 0.0
    untied = np.log1p(np.sqrt(sum_over_window((loose * worth[1].max(axis=1)) ** 2, travel)))
    return np.stack(
        [
            jump,
            over_window(share(found.step), travel),
            np.sqrt(np.nan_to_num(share(sum_over_window(found.recent, travel)))),
            untied,
            np.sqrt(np.nan_to_num(share(sum_over_window(found.old, travel)))),
            np.full(len(travel), usual(found)),
        ],
        axis=1,
    )


def usual(found: Evidence) -> float:
    """By how much wheels and trajectory disagree in a tenth of the motions at least, log(1 + sigmas)."""
    whitened = found.wheels.whitened
    known = whitened[np.isfinite(whitened)]
    return float(np.log1p(np.percentile(known, 90))) if len(known) else 0.0


def map_features(found: Evidence, keyframes: Array) -> Array:
    """(10,) of `MAP_FEATURES`; `keyframes` (K, 6) are those of the keyframes."""
    largest = keyframes.max(axis=0) if len(keyframes) else np.zeros(len(KEYFRAME_FEATURES))
    recent, old = (np.sqrt(np.nan_to_num(share(each.sum(axis=0)[None])))[0] for each in _known(found))
    offset = 0.0
    if found.mount is not None:
        beyond = np.maximum(np.abs(found.mount.offset) - _BEYOND * found.mount.sigmas, 0.0)
        offset = float(np.log1p(np.hypot(beyond[0], beyond[1]) / 0.1 + beyond[2] / 0.1))
    mirrored = 0.0
    if found.mirror is not None:
        mirrored = float(np.log1p(max(0.0, found.mirror.sigmas - MIRROR_SIGMAS)))
    late = 0.0 if found.lag is None else abs(found.lag.seconds) * max(found.lag.gain, 0.0)
    return np.array(
        [largest[0], largest[1], recent, largest[3], old, largest[4], usual(found), offset, mirrored, float(late)]
    )


def _known(found: Evidence) -> tuple[Array, Array]:
    return np.nan_to_num(found.recent), np.nan_to_num(found.old)


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
