"""The usual mistakes in poses with covariances, each found by its own numbers: units, columns, order, rank, clocks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from sixthsense.auditing.pairing import Align, Errors, Pair, fitted, rms
from sixthsense.auditing.poses import POSITION, Poses, is_of_plane
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.evaluation.metrics import has_full_rank

WRONG = "cannot be right"
"""how a line on a mistake begins"""
UNIFORM_RAD = math.pi / math.sqrt(3.0)
"""sigma of a direction of which nothing is known"""

_DEGREE = math.pi / 180.0
_FEWEST = 20  # poses and ways
_FITS, _UNLIKE = 0.2, 0.5  # share of the spread or of the errors that remains: one cause, other drives
_SCALE, _TURNED_RAD, _STEADY = 1.2, math.radians(10.0), 0.9  # of units and axes that are worth a word
_NEAR = 1.5  # times: the errors over what a mistake would make of them


def of_estimate(poses: Poses) -> Iterator[str]:
    """A line for each mistake that an estimate shows without a truth: order, degrees, rank."""
    assert poses.covs is not None
    count = len(poses)
    # A robot on a floor states x, y and yaw: rows 0, 1 and 5, or with the rotation first 2, 3 and 4.
    stated = np.einsum("kii->ki", poses.covs).any(axis=0).tolist()
    if swapped := stated == [False, False, True, True, True, False]:
        yield "only the variances of z, roll, pitch are stated, as with the rotation first (order rotation)"
    covs = (poses.in_plane() if not poses.is_planar and is_of_plane(poses) else poses).covs
    assert covs is not None
    n = POSITION[covs.shape[1]]
    largest = np.sqrt(np.maximum(np.einsum("kii->ki", covs)[:, n:].max(axis=1), 0.0))
    if (beyond := int(np.sum(largest > UNIFORM_RAD))) and not swapped:
        above = (
            f"a rotation of sigma above {UNIFORM_RAD:.2f} rad, that of an unknown direction, up to {largest.max():.3g}"
        )
        yield f"{beyond:,} of {count:,} poses have {above}: in degrees, or of the other order?"
    defective = ~has_full_rank(covs)
    defective[0] &= covs[0].any()  # where its frame begins, a map knows the robot exactly
    if (singular := int(np.sum(defective))) and not swapped:
        yield f"{singular:,} of {count:,} covariances are not positive definite: their poses are left out"


def of_errors(errors: Errors) -> Iterator[str]:
    """A line for covariances in another unit than the errors: variances in degrees², or of headings, or sigmas."""
    variances, squares = np.einsum("kii->ki", errors.cov).mean(axis=0), (errors.error**2).mean(axis=0)
    n = POSITION[errors.error.shape[1]]
    ratios = np.sqrt(squares / variances)
    place, turn = ratios[:n].mean(), ratios[n:].mean() / max(ratios[:n].mean(), 1e-12)
    alike = (squares < _NEAR**2 * variances**2) & (variances**2 < _NEAR**2 * squares)
    if alike.all() and not 0.5 < place < 2.0:
        yield "each stated variance is as large as the error itself: are these sigmas in place of variances?"
    elif 1.0 / _NEAR < turn / _DEGREE < _NEAR:
        yield f"errors of rotations are {turn:.3g} times as large beside their sigmas: are the variances in degrees²?"
    elif 1.0 / _NEAR < turn * _DEGREE < _NEAR:
        yield f"errors of rotations are {turn:.3g} times as large beside their sigmas: are headings in degrees?"


def of_columns(pair: Pair) -> Iterator[str]:
    """A line on the columns of x, y and heading that are exchanged, by the truth."""
    found = np.column_stack([pair.estimate.positions[:, :2], np.unwrap(pair.estimate.headings)])
    true = pair.truth.positions[:, :2]
    spread_m, left = max(rms(true - true.mean(axis=0)), 1e-9), {}
    for order in itertools.permutations(range(3)):
        places = found[:, order[:2]]
        turn, shift = fitted(places, true)
        left[order] = rms(places @ turn.T + shift - true) / spread_m
    best = min(left, key=lambda order: left[order])
    if left[best] <= _FITS <= left[0, 1, 2] and 3.0 * left[best] <= left[0, 1, 2]:
        given = ", ".join(("x", "y", "theta")[best.index(k)] for k in range(3))
        yield f"{WRONG}: columns of {pair.estimate.name} fit the truth as {given}, not as x, y, theta"


def of_poses(pair: Pair, align: Align) -> Iterator[str]:
    """A line for each thing that poses in the plane show beside the truth, with the figures.

    Whether they are of one drive, by their turns and their shape; and if they are: units, frames, axes, clocks.
    """
    if not pair.estimate.is_planar or len(pair.estimate) < _FEWEST:
        return
    if exchanged := [*of_columns(pair)]:
        yield from exchanged
        return
    found, true = pair.estimate.positions[:, :2], pair.truth.positions[:, :2]
    headings = pair.estimate.headings, pair.truth.headings
    turn, shift = fitted(found, true)
    apart_m, own, way = rms(found @ turn.T + shift - true), found - found.mean(axis=0), true - true.mean(axis=0)
    spread_m = rms(way)
    scale = spread_m / max(rms(own), 1e-9)
    left = rms(scale * own @ turn.T - way) / max(spread_m, 1e-9)
    names = pair.estimate.name, pair.truth.name
    if left > _UNLIKE and (correlation := _correlation(*headings)) < _UNLIKE:
        yield (
            f"{' and '.join(names)} may not be of one drive, or have other clocks: their turns correlate by "
            f"{correlation:.2f}, and aligned they are {apart_m:.3g} m apart, where the way has a spread of "
            f"{spread_m:.3g} m"
        )
        return
    if left < _FITS and max(scale, 1.0 / scale) > _SCALE:
        yield f"positions of {names[1]} are {scale:.3g} times those of {names[0]}: are both in metres?"
        return
    if align == "none" and apart_m < _FITS * (ate_m := rms(found - true)):
        falls = f"the ATE falls from {ate_m:.2f} to {apart_m:.2f} m"
        yield f"the frames differ: aligned by all poses (`align` all) {falls}"
    off = wrap_angle(headings[0] - headings[1] + math.atan2(turn[1, 0], turn[0, 0]))
    mean = complex(np.mean(np.exp(1j * off)))
    if abs(mean) < _UNLIKE:
        yield f"{WRONG}: headings of {names[0]} do not turn as those of {names[1]}: are they in degrees?"
        return
    if abs(mean) > _STEADY and abs(np.angle(mean)) > _TURNED_RAD:
        differ = f"headings differ by {math.degrees(np.angle(mean)):.0f}° all along, beside the frames"
        yield f"{differ}: the two have other axes of the body"
    yield from _other_clock(pair, wrap_angle(off - np.angle(mean)), headings[1])


def _correlation(found: Array, true: Array) -> float:
    """Of the turns of two headings (N,) over the same times; 0 where one of them does not turn."""
    rows = np.unique(np.linspace(0, len(found) - 1, 101).astype(np.int64))
    one, other = (wrap_angle(np.diff(headings[rows])) for headings in (found, true))
    size = math.sqrt(float(one @ one) * float(other @ other))
    return float(one @ other) / size if size > 0.0 else 0.0


def _other_clock(pair: Pair, off: Array, headings: Array) -> Iterator[str]:
    """Errors of headings that are proportional to the rate of turning: those of a delay."""
    seconds = 1e-9 * (pair.truth.stamps_ns - pair.truth.stamps_ns[0]).astype(np.float64)
    rate = np.gradient(np.unwrap(headings), seconds)
    power = float(rate @ rate)
    delay = -float(rate @ off) / power if power > 0.0 else 0.0
    left = rms((off + delay * rate)[:, None]) / max(rms(off[:, None]), 1e-12)
    if left < 1.0 - _FITS and abs(delay) > float(np.median(np.diff(seconds))):
        late = f"about {abs(delay):.2g} s {'late' if delay > 0.0 else 'early'}, by the errors of headings in turns"
        yield f"stamps of the estimate are {late} (if so set `time_offset` {-delay:.2f})"
