"""The verdict on a run: evidence, probability, cause."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sixthsense.verdict.causes import causes_of
from sixthsense.verdict.evidence import Evidence, evidence_of, share
from sixthsense.verdict.probability import (
    FEATURES,
    keyframe_features,
    logistic,
    map_features,
    noisy_or,
    weights,
)
from sixthsense.verdict.verdict import Level, Verdict
from sixthsense.verdict.views import FEWEST, THROUGH, TWICE
from sixthsense.verdict.witnesses import Witnesses

DOUBTFUL_FROM, BROKEN_FROM = 0.5, 0.9
"""A map is doubtful if it is more likely wrong than right, and broken if it is at least nine times as likely."""


def judge(found: Witnesses) -> Verdict:
    """Whether the map of a run is right, by what the run has left behind."""
    evidence, model = evidence_of(found), weights()
    features = keyframe_features(evidence)
    keyframes = logistic(model["keyframes"], FEATURES, features)
    probability = float(noisy_or(model["map"], FEATURES, map_features(evidence, features)[None])[0])
    level: Level = "good"
    if probability >= DOUBTFUL_FROM:
        level = "broken" if probability >= BROKEN_FROM else "doubtful"
    causes = () if level == "good" or not len(keyframes) else causes_of(evidence, found)
    return Verdict(level, probability, keyframes, causes, dict(_numbers(evidence)))


def _numbers(evidence: Evidence) -> Iterator[tuple[str, float]]:
    """What is known of a run, by the keys of its metrics."""
    whitened = evidence.wheels.whitened
    if np.isfinite(whitened).any():
        yield "verdict_disagreement_p90", float(np.nanpercentile(whitened, 90))
        yield "verdict_disagreement_max", float(np.nanmax(whitened))
    for name, found in (("recent", evidence.recent), ("old", evidence.old)):
        if np.isfinite(found).any():
            total = np.nansum(found, axis=0)[None]
            for kind, column in (("contradicted", THROUGH), ("twice", TWICE)):
                value = float(share(total, column)[0])
                if np.isfinite(value):
                    yield f"verdict_{kind}_{name}", value
    if np.isfinite(evidence.recent).any():
        yield "verdict_keyframes_unseen", float((evidence.recent[1:, 0] < FEWEST).sum())
    if evidence.turns is not None:
        yield "verdict_turn_slope", evidence.turns.slope
    if evidence.mount is not None:
        yield "verdict_mount_x_m", float(evidence.mount.offset[0])
        yield "verdict_mount_y_m", float(evidence.mount.offset[1])
        yield "verdict_mount_theta_rad", float(evidence.mount.offset[2])
    if evidence.lag is not None:
        yield "verdict_lag_s", evidence.lag.seconds
