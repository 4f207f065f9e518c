"""How far the wheels and the trajectory disagree, and what would explain it: a mirror, a mount, a delay."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose
from sixthsense.logs.diagnose import Mount, hand_eye
from sixthsense.verdict.views import SURFACE, THROUGH, Views, compared_at

_SIGMA_M, _M_PER_M, _M_PER_RAD = 0.02, 0.05, 0.02  # what wheels in general are wrong by, per motion
_SIGMA_RAD, _RAD_PER_RAD, _RAD_PER_M = 0.01, 0.05, 0.02
_TURN_RAD, _MOST_PAIRS = 0.1, 400  # a turn that tells a mirror, and pairs of scans that are tried
_LAGS_S, _LAG_STEPS = 3.0, 61
_FEWEST = 8  # motions that a fit needs


class Disagreement(NamedTuple):
    """The motions to keyframes by the trajectory and by the wheels; rows of what is not known are NaN."""

    wheels: Array
    """(K, 3) motion since the keyframe before, by the wheels"""
    path: Array
    """(K, 3) by the trajectory"""
    off: Array
    """(K, 3) motion by the trajectory in the frame after that by the wheels"""
    sigmas: Array
    """(K, 3) what wheels in general are wrong by on such a motion"""


def disagreement(wheels: Array | None, trajectory: Array, measured: NDArray[np.bool_]) -> Disagreement:
    """Of keyframes with poses (K, 3) by the wheels alone, None without any, and by the trajectory (K, 3)."""
    count = len(trajectory)
    by_wheels, by_path, off, sigmas = (np.full((count, 3), np.nan) for _ in range(4))
    if wheels is None or count < 2:
        return Disagreement(by_wheels, by_path, off, sigmas)
    by_wheels[1:], by_path[1:] = between(wheels[:-1], wheels[1:]), between(trajectory[:-1], trajectory[1:])
    off[1:] = between(by_wheels[1:], by_path[1:])
    way = np.maximum(np.hypot(by_wheels[:, 0], by_wheels[:, 1]), np.hypot(by_path[:, 0], by_path[:, 1]))
    turn = np.maximum(np.abs(by_wheels[:, 2]), np.abs(by_path[:, 2]))
    sigmas[:, 0] = sigmas[:, 1] = _SIGMA_M + _M_PER_M * way + _M_PER_RAD * turn
    sigmas[:, 2] = _SIGMA_RAD + _RAD_PER_RAD * turn + _RAD_PER_M * way
    by_wheels[~measured], off[~measured] = np.nan, np.nan
    return Disagreement(by_wheels, by_path, off, sigmas)


class Mirror(NamedTuple):
    """A part of the run in which scans fit the wheels' motions better if these are seen in a mirror."""

    first: int
    """keyframe at which it begins"""
    last: int
    sigmas: float
    """by which the mirror wins more of the pairs of scans than by chance; 0 where it wins in no part"""


def mirror(views: Views, found: Disagreement) -> Mirror:
    """Compare successive scans at the wheels' motions, and at those seen by a laser that exchanges left and right.

    The part in which the mirror wins is the one with the largest surplus of wins, as of a sign test.
    """
    nowhere, wheels = Mirror(0, 0, 0.0), np.nan_to_num(found.wheels[:, 2])
    turning = np.flatnonzero(np.abs(wheels) > _TURN_RAD)
    if not len(turning) or not len(views.ranges):
        return nowhere
    turning = turning[np.unique(np.linspace(0, len(turning) - 1, _MOST_PAIRS).astype(np.int64))]
    pairs, mount = np.stack([turning - 1, turning], axis=1), views.mounts[turning]
    motions = laser_motions(found.wheels[turning], mount)
    results = [compared_at(views, pairs, each) for each in (motions, motions * (1.0, -1.0, -1.0))]
    one, other = (each[:, SURFACE] / np.maximum(each[:, SURFACE] + each[:, THROUGH], 1) for each in results)
    won = np.sign(np.round(other - one, 9))
    total = np.concatenate([[0.0], np.cumsum(won)])
    surplus = total[1:] - np.minimum.accumulate(total)[:-1]
    last = int(np.argmax(surplus))
    first = int(np.argmin(total[: last + 1]))
    size = float(np.abs(won[first : last + 1]).sum())
    if surplus[last] <= 0.0:
        return nowhere
    return Mirror(int(turning[first]), int(turning[last]), float(surplus[last]) / math.sqrt(size))


def laser_motions(motions: Array, mounts: Array) -> Array:
    """(m, 3) motions of lasers, of those of robots (m, 3)."""
    return between(mounts, compose(motions, mounts))


def mount(found: Disagreement) -> Mount | None:
    """The mount that explains the motions best, by hand-eye calibration; None where too little is known."""
    known = np.isfinite(found.off).all(axis=1)
    return hand_eye(found.wheels[known], found.path[known], found.sigmas[known, 0])


class Turns(NamedTuple):
    """A turn of the trajectory as a function of the wheels' turn."""

    slope: float
    """of the turns; 1 where they agree, -1 where a mirror is between them"""
    sigma: float
    correlation: float


def turns(found: Disagreement) -> Turns | None:
    """The slope of the trajectory's turns over the wheels'; None where they turn too little to tell."""
    known = np.isfinite(found.off).all(axis=1)
    w, t = found.wheels[known, 2], found.path[known, 2]
    power = float(w @ w)
    if len(w) < _FEWEST or power < _TURN_RAD**2 * _FEWEST:
        return None
    slope = float(w @ t) / power
    sigma = float(np.linalg.norm(t - slope * w) / np.sqrt(max(len(w) - 1, 1) * power))
    scale = float(np.sqrt(power * (t @ t)))
    return Turns(slope, sigma, float(w @ t) / scale if scale > 0.0 else 0.0)


class Lag(NamedTuple):
    """By how much the scans are later than the wheels."""

    seconds: float
    gain: float
    """share of what is off without a delay that the delay explains"""


def lag(stamps_s: Array, wheels: Array, poses: Array) -> Lag | None:
    """The delay between the turns of scans (S, 3) and of wheels (S, 3) that explains most; None where none can be told.

    Both headings are taken at even times. What is left of a delayed turn is compared with what is left without.
    """
    if len(stamps_s) < 50 or stamps_s[-1] - stamps_s[0] < 10.0 * _LAGS_S:
        return None
    step_s = max(float(np.median(np.diff(stamps_s))), 0.02)
    times = np.arange(stamps_s[0] + _LAGS_S, stamps_s[-1] - _LAGS_S, step_s)
    if not 50 <= len(times) <= 200_000:
        return None
    turned, own = (np.unwrap(each[:, 2]) for each in (wheels, poses))
    rate = np.diff(np.interp(times, stamps_s, own))
    if float(rate @ rate) < 1e-3:
        return None
    lags = np.linspace(-_LAGS_S, _LAGS_S, _LAG_STEPS)
    old = [np.diff(np.interp(times - each, stamps_s, turned)) for each in lags]
    left = np.array([float(np.mean(np.abs(rate - each))) for each in old])
    best, none = int(np.argmin(left)), _LAG_STEPS // 2
    return Lag(float(lags[best]), 1.0 - left[best] / max(left[none], 1e-12))
