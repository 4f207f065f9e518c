"""The verdict on a run: evidence, probability, cause."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sixthsense.verdict.causes import causes_of, remarks_of
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
from sixthsense.verdict.views import FEWEST, SURFACE, THROUGH, TWICE
from sixthsense.verdict.witnesses import Witnesses

DOUBTFUL_FROM, BROKEN_FROM = 0.5, 0.9
"""A map is doubtful if it is more likely wrong than right, and broken if it is at least nine times as likely."""


_LEAST_TRAVEL_M = 2.0
"""with a turn of a radian as half a metre: scans of one place do not contradict each other"""


def judge(found: Witnesses) -> Verdict:
    """Whether the map of a run is right, by what the run has left behind.

    A map that nothing speaks against is good if enough of its scans were compared with others; else it is not judged.
    """
    evidence, model = evidence_of(found), weights()
    features = keyframe_features(evidence)
    keyframes = logistic(model["keyframes"], FEATURES, features)
    probability = float(noisy_or(model["map"], FEATURES, map_features(evidence, features)[None])[0])
    level: Level = "good"
    if probability >= DOUBTFUL_FROM:
        level = "broken" if probability >= BROKEN_FROM else "doubtful"
    reason = _unjudged(evidence, found) if level == "good" else ""
    if reason:
        return Verdict("unjudged", None, keyframes, (), dict(_numbers(evidence)), reason)
    causes = (remarks_of if level == "good" else causes_of)(evidence, found) if len(keyframes) else ()
    return Verdict(level, probability, keyframes, causes, dict(_numbers(evidence)))


def _unjudged(evidence: Evidence, found: Witnesses) -> str:
    """Why nothing speaks for the map; empty if something does."""
    if found.own_front_end:
        return f"the verdict is fitted to shipped front ends, not to {found.own_front_end}"
    if not any(scan is not None for scan in found.scans):
        return "there are no scans that could contradict each other"
    if not len(evidence.travel) or evidence.travel[-1] < _LEAST_TRAVEL_M:
        return "the robot hardly moved, by its own odometry and scans"
    if np.median(evidence.returns) < FEWEST:
        return f"a scan has {np.median(evidence.returns):.0f} returns, {FEWEST} are needed"
    compared = np.nansum([evidence.recent, evidence.old], axis=0)[:, [SURFACE, THROUGH]].sum(axis=1)
    if np.mean(compared >= FEWEST) < 0.5:
        return "few scans show what other scans have shown"
    return ""


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
