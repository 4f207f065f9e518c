"""What poses beside the truth tell of errors that are no estimator's: another drive, frame, unit, or clock."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sixthsense.auditing import rotations
from sixthsense.auditing.pairing import Align, Pair
from sixthsense.auditing.scores import fitted
from sixthsense.core.geometry import Array, wrap_angle

_FEWEST, _MOST = 10, 100  # motions that are compared, evenly over the time
_UNLIKE, _UNLIKE_TURNS = 0.5, 0.5  # share of the positions' spread that remains, and correlation of turns: other drives
_FITS = 0.2  # share of the errors that a cause leaves
_SCALE, _TURNED_RAD, _STEADY = 1.2, math.radians(10.0), 0.9  # of units and axes that are worth a word
_JUMP, _JUMP_ATE = 20.0, 0.5  # times the usual step, and share of the aligned error, of a single one


def hints(pair: Pair, align: Align) -> Iterator[str]:
    """A line for each thing that the poses of a pair, in the plane, tell of themselves, with the figures that say so.

    Whether they are of one drive, by their turns and their shape; and if they are: units, frames, axes, clocks, jumps.
    """
    if not pair.estimate.is_planar or len(pair.estimate) <= _FEWEST:
        return
    found, true = pair.estimate.positions, pair.truth.positions
    headings = [rotations.log(one.orientations)[:, 0] for one in (pair.estimate, pair.truth)]
    spread = _rms(true - true.mean(axis=0))
    turn, shift = fitted(found, true)
    apart = found @ turn.T + shift - true
    scale = spread / max(_rms(found - found.mean(axis=0)), 1e-9)
    both = f"{pair.estimate.name} and {pair.truth.name}"
    correlation = _correlation(*headings)
    scaled = found @ turn.T * scale
    left = _rms(scaled - scaled.mean(axis=0) - (true - true.mean(axis=0))) / max(spread, 1e-9)
    if left > _UNLIKE and correlation < _UNLIKE_TURNS:
        yield (
            f"{both} may not be of one drive, or have other clocks: their turns correlate by {correlation:.2f}, "
            f"and aligned they are {_rms(apart):.3g} m apart, where the way has a spread of {spread:.3g} m"
        )
        return
    if left < _FITS and max(scale, 1.0 / scale) > _SCALE:
        yield f"positions of {pair.truth.name} are {scale:.3g} times those of {pair.estimate.name}: are both in metres?"
        return
    if align == "none" and _rms(apart) < _FITS * _rms(found - true):
        yield (
            f"the frames differ: aligned by all poses (`align` all) the ATE falls from {_rms(found - true):.2f} to "
            f"{_rms(apart):.2f} m"
        )
    off = wrap_angle(headings[0] - headings[1] + math.atan2(turn[1, 0], turn[0, 0]))
    mean = complex(np.mean(np.exp(1j * off)))
    if abs(mean) > _STEADY and abs(np.angle(mean)) > _TURNED_RAD:
        yield (
            f"headings differ by {math.degrees(np.angle(mean)):.0f}° all along, beside the frames: the two have other "
            "axes of the body"
        )
    yield from _other_clock(pair, wrap_angle(off - np.angle(mean)), headings[1])
    yield from _jump(pair, apart)


def _correlation(found: Array, true: Array) -> float:
    """Of the turns of two headings (N,) over the same times; 0 where one of them does not turn."""
    rows = np.unique(np.linspace(0, len(found) - 1, _MOST + 1).astype(np.int64))
    one, other = (wrap_angle(np.diff(headings[rows])) for headings in (found, true))
    size = math.sqrt(float(one @ one) * float(other @ other))
    return float(one @ other) / size if size > 0.0 else 0.0


def _other_clock(pair: Pair, off: Array, headings: Array) -> Iterator[str]:
    """Errors of headings that are proportional to the rate of turning: those of a delay."""
    seconds = 1e-9 * (pair.truth.stamps_ns - pair.truth.stamps_ns[0]).astype(np.float64)
    rate = np.gradient(np.unwrap(headings), seconds)
    power = float(rate @ rate)
    delay = -float(rate @ off) / power if power > 0.0 else 0.0
    left = _rms((off + delay * rate)[:, None]) / max(_rms(off[:, None]), 1e-12)
    if left < 1.0 - _FITS and abs(delay) > float(np.median(np.diff(seconds))):
        word = "late" if delay > 0.0 else "early"
        yield (
            f"stamps of the estimate are about {abs(delay):.2g} s {word}, by the errors of headings in turns "
            "(`time_offset` measures it)"
        )


def _jump(pair: Pair, apart: Array) -> Iterator[str]:
    steps = np.linalg.norm(np.diff(apart, axis=0), axis=1)
    most = int(np.argmax(steps))
    if steps[most] > _JUMP * np.median(steps) and steps[most] > _JUMP_ATE * _rms(apart):
        at_s = 1e-9 * float(pair.estimate.stamps_ns[most + 1])
        yield f"at {at_s:.2f} s the estimate jumps by {steps[most]:.2f} m beside the truth"


def _rms(rows: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
