"""The verdict on a run: evidence, probability, cause."""

from __future__ import annotations

import numpy as np

from sixthsense.verdict import probability as fitted
from sixthsense.verdict.causes import causes_of, remarks_of
from sixthsense.verdict.evidence import Evidence, evidence_of, share
from sixthsense.verdict.probability import FEATURES
from sixthsense.verdict.verdict import Level, Verdict
from sixthsense.verdict.views import ALL, FEWEST, SURFACE, THROUGH
from sixthsense.verdict.witnesses import Witnesses

DOUBTFUL_FROM, BROKEN_FROM = 0.4, 0.9
"""Probabilities of being wrong. The first lies below a half: a wrong map called good costs more than a second look."""
_LEAST_TRAVEL_M = 2.0
"""with a turn of a radian as half a metre: scans of one place do not contradict each other"""


def judge(found: Witnesses) -> Verdict:
    """Whether the map of a run is right, by what the run has left behind.

    A map below the first limit is good if enough of its scans were compared with others; else it is not judged.
    """
    evidence, model = evidence_of(found), fitted.weights()
    features = fitted.keyframe_features(evidence)
    keyframes = fitted.logistic(model["keyframes"], FEATURES, features)
    probability = float(fitted.noisy_or(model["map"], FEATURES, fitted.map_features(evidence, features)[None])[0])
    level: Level = "good"
    if probability >= DOUBTFUL_FROM:
        level = "broken" if probability >= BROKEN_FROM else "doubtful"
    reason = _unjudged(evidence, found) if level == "good" or evidence.returns.max(initial=0.0) < FEWEST else ""
    if reason:
        return Verdict("unjudged", None, keyframes, (), _numbers(evidence), reason)
    causes = (remarks_of if level == "good" else causes_of)(evidence, found) if len(keyframes) else ()
    return Verdict(level, probability, keyframes, causes, _numbers(evidence))


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


def _numbers(evidence: Evidence) -> dict[str, float]:
    """What is known of a run, by the keys of its metrics."""
    numbers = {"keyframes_passed_before": float(np.count_nonzero(evidence.old[:, ALL] > 0.0))}
    for name, found in (("recent", evidence.recent), ("old", evidence.old)):
        numbers[f"verdict_contradicted_{name}"] = share(np.nansum(found, axis=0)[None])[0]
    return {name: float(number) for name, number in numbers.items() if np.isfinite(number)}
