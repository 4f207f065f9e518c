"""Tracking: the pose of a scan among keyframes near it.

Odometry proposes a pose, and the scans correct it. A scan is aligned from a few starts, and the pose with the largest
log-odds is taken: the probability of the motion, by wheels which sometimes slip, times that of what the scan sees
there, by what scans usually see, over the probability of a motion as predicted whose scan is no evidence. The scan is
lost if these are negative, and the wheels have slipped if that is the likelier motion.

How large the errors of the wheels are in this run is learnt from the scans. Wheels differ by more than a factor of ten.
What is known of any wheels is where the estimate begins: two factors on the sigmas of that model, one of position and
one of heading, are the maximum of the likelihood of the motions so far. It is found by expectation maximisation, with
Student's distribution in place of the normal one, so that a slip counts little (Lange, Little and Taylor, "Robust
statistical modeling using the t distribution", JASA 84, 1989).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.covariance import SIGNIFICANT
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import (
    Triple,
    added,
    between,
    compose,
    conjugate,
    inverse,
    inverse_covariance,
    move_covariance,
    product,
    triple,
    whitening,
    wrapped,
)
from sixthsense.slam.scans.agreement import agreement_of, contradicted
from sixthsense.slam.scans.alignment import SIGMA_M, Prior, Sums, Views, align
from sixthsense.slam.scans.links import FEW_RETURNS, NEAR_GATE_M, SEEN_SHARE, WIDE_GATE_M
from sixthsense.slam.scans.places import MOST_TRIED, PLACE, Window, peaks, pyramid, surfaces

SLIP_SIGMAS = 6.0
"""scale of the loss on the distance of a motion from that of the wheels; beyond it other starts are tried"""
SLIP = WIDE_GATE_M
"""sigma of a motion that the wheels have missed, m and rad: the scans are aligned from as far"""
TARGETS = 3
"""keyframes that a scan is tracked against"""
_RARE = 0.02  # probability that wheels slip, that a scan is no evidence, and of a return that is seen through, at least
_CHANCE, _THROUGH = 0.15, 0.4  # share of judged returns that lie on lines, and that are seen through, at a wrong pose
_DOUBTED = 0.1  # share of returns that are seen through, beyond the usual one, at which other starts are tried
_NEWEST_SHARE = 0.02  # of the newest scan in what is usual
_SURFACE = 5.0  # neighbouring returns of one surface, which are one piece of evidence
_VARIES = 4.0  # pieces of evidence that what is usual of lines counts as
FREEDOM = 4.0
"""degrees of freedom of Student's distribution of a motion: floors and loads change, wheels slip now and then"""
PRIOR_COUNT = 10.0
"""observations that what is known of a variance beforehand counts as"""
_MEMORY = 200.0  # motions that are remembered


class WheelNoise:
    """Factors on the covariance of wheels in general."""

    def __init__(self) -> None:
        self.factors = np.ones((3, 3))
        """(3, 3) on the covariance of (x, y, theta)"""
        self._variances = np.ones(2)
        """of position and heading, over those of the model"""
        self._count = PRIOR_COUNT

    def update(self, stated: Array, off: Array, left: Array, heading: float) -> None:
        """Update with a motion of error `off` (3,), which is known up to the covariance `left` (3, 3).

        `stated` (3, 3) is the covariance by the model, axes of the laser where the motion ends, whose heading is
        `heading` in those of the others.
        """
        turned, (c, s) = move_covariance((0.0, 0.0, -heading), left), (math.cos(heading), math.sin(heading))
        x, y = c * off[0] + s * off[1], c * off[1] - s * off[0]
        position = (x * x + turned[0, 0]) / stated[0, 0] + (y * y + turned[1, 1]) / stated[1, 1]
        turn = (off[2] ** 2 + turned[2, 2]) / stated[2, 2]
        totals, dimensions = np.array([position, turn]), np.array([2.0, 1.0])
        weights = (FREEDOM + dimensions) / (FREEDOM + totals / self._variances)
        self._variances += (weights * totals / dimensions - self._variances) / (self._count + 1.0)
        sigmas = np.sqrt(self._variances[[0, 0, 1]])
        self.factors = np.outer(sigmas, sigmas)
        self._count = min(self._count + 1.0, _MEMORY)


class LastScan(NamedTuple):
    """The last scan, as tracked."""

    pose: Array
    """(3,) `T_world_laser`"""
    since: Triple
    """motion of the robot from the last keyframe until then, by odometry"""
    motion: Triple
    """of the laser, from the scan before to this one"""


class Expected(NamedTuple):
    """What is known of a scan's pose before it is aligned."""

    prior: Prior
    """by odometry since the last keyframe; world frame"""
    starts: Array
    """(3, 3) poses to begin at: by odometry; moving as before, where wheels are wrong; and standing, where they spin"""
    stated: Array
    """(3, 3) of the laser's motion since the last keyframe by wheels in general, axes of the laser after it"""


@numba.njit(cache=True, error_model="numpy")
def expected(key: Array, last: LastScan, mount: Triple, since: Triple, cov: Array, factors: Array) -> Expected:
    """Compute what is known of the newest scan's pose by the odometry since the last keyframe.

    `key` (3,) is the keyframe's `T_world_laser`, `since` the robot's motion from there, `cov` (3, 3) its covariance by
    wheels in general, `factors` (3, 3) are on it by the wheels of this run, and `mount` is `T_robot_laser`.
    """
    back, before = inverse(mount), triple(last.pose)
    own = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            own[i, j] = cov[i, j] * factors[i, j]
    pose = np.array(compose(triple(key), conjugate(back, since)))
    information = inverse_covariance(move_covariance((0.0, 0.0, pose[2]), move_covariance(back, own)))
    step = conjugate(back, compose(inverse(last.since), since))
    starts = np.array((compose(before, step), compose(before, last.motion), before))
    return Expected(Prior(pose, information, SLIP_SIGMAS), starts, move_covariance(back, cov))


class Usual(NamedTuple):
    """What scans lately had where they were tracked."""

    contradicted: float
    """share of returns that are seen through, of those that are judged"""
    lines: float
    """share of the same that lie on lines"""


class Tracked(NamedTuple):
    """A scan's pose among keyframes."""

    pose: Array
    """(3,) `T_world_laser`"""
    cov: Array
    """(3, 3) of the error of (x, y, theta), world axes, by scans and odometry together"""
    off: Array
    """(3,) of the pose from the odometry, world axes"""
    square: float
    """squared Mahalanobis distance of the pose from the odometry"""
    log_odds: float
    """log of the probability of this pose over that of a motion as predicted whose scan is no evidence"""
    contradicted: float
    """share of the returns that are seen through, of those that are judged"""
    lines: float
    """share of the same that lie on lines"""
    has_slipped: bool
    """whether it is likelier that the wheels have slipped than that they have not"""

    @property
    def is_lost(self) -> bool:
        """Whether it is likelier that the scan is no evidence than that it is from this pose."""
        return self.log_odds < 0.0

    def usual(self, before: Usual) -> Usual:
        """What scans usually have, this one included."""
        newest = self.contradicted, self.lines
        return Usual(*(old + _NEWEST_SHARE * (new - old) for old, new in zip(before, newest, strict=True)))


@numba.njit(cache=True, error_model="numpy")
def track(views: Views, prior: Prior, starts: Array, usual: Usual, is_guess: bool) -> Tracked:
    """The likeliest pose of a scan among keyframes.

    `starts` (n, 3) are poses to begin at, the first by odometry since the scan before. The pose from there is taken if
    it `_is_usual`, and otherwise that from the prior's own pose, held by the prior, if that is: someone who walks ahead
    in a corridor is seen where he was, and nothing else holds the scan. Else it is the likeliest of these and of those
    from all starts with a wide gate and little weight of the odometry. `is_guess` is whether nothing has measured the
    prior.
    """
    best = tracked_at(views, prior, prior, starts[0], NEAR_GATE_M, usual, is_guess)
    if _is_usual(best, usual):
        return best
    firm, weak = Prior(prior.pose, prior.information, np.inf), Prior(prior.pose, np.eye(3) / SLIP**2, np.inf)
    held = tracked_at(views, prior, firm, prior.pose, NEAR_GATE_M, usual, is_guess)
    if _is_usual(held, usual):
        return held
    if held.log_odds > best.log_odds:
        best = held
    for k in range(len(starts)):
        other = tracked_at(views, prior, weak, starts[k], WIDE_GATE_M, usual, is_guess)
        if other.log_odds > best.log_odds:
            best = other
    return best


@numba.njit(cache=True, error_model="numpy")
def _is_usual(found: Tracked, usual: Usual) -> bool:
    """Whether the wheels allow a pose, and no more than usually is contradicted."""
    return found.square <= SLIP_SIGMAS**2 and found.contradicted < usual.contradicted + _DOUBTED


def search(views: Views, prior: Prior, usual: Usual, is_guess: bool) -> Tracked:
    """The likeliest pose of a scan in the submap of the targets, of which there is one at least, within a slip.

    Each place where enough of its returns fit the submap is tried.
    """
    returns, loose = views.returns, Prior(prior.pose, np.eye(3) / SLIP**2, math.inf)
    points, own = returns.points[views.source], surfaces(returns, views.targets, between(prior.pose, views.at))
    window = Window(np.zeros(3), SIGNIFICANT * SLIP, SIGNIFICANT * SLIP)
    submap, seen = pyramid(np.ascontiguousarray(own[:, :2])), points[points[:, 2] > 0.0, :2].astype(np.float64)
    rows = peaks(submap, seen, window, SEEN_SHARE, PLACE, MOST_TRIED) if len(seen) else np.zeros((0, 4))
    places, found = [prior.pose, *compose(prior.pose, rows[:, 1:]).reshape(-1, 3)], list[Tracked]()
    for place in places:
        off = views.at - place
        near = np.argsort(np.hypot(off[:, 0], off[:, 1]) + np.abs(wrap_angle(off[:, 2])), kind="stable")[:TARGETS]
        around = views._replace(targets=views.targets[near], at=views.at[near])
        found.append(tracked_at(around, prior, loose, place, WIDE_GATE_M, usual, is_guess))
    return max(found, key=lambda each: each.log_odds)


class Aligned(NamedTuple):
    """A scan as aligned with others."""

    pose: Array
    """(3,) of the laser, frame of the others' poses"""
    information: Array
    """(3, 3) of the error of (x, y, theta), same axes, by the scans alone; positive semi-definite"""


@numba.njit(cache=True, error_model="numpy")
def aligned(views: Views, prior: Prior, start: Array, gate_m: float) -> Aligned:
    """The pose that a scan is aligned at among others from `start` (3,), with partners up to `gate_m` at first."""
    pose, sums = start.copy(), Sums(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(1))
    align(views, prior, gate_m, False, pose, sums)
    values, axes = np.linalg.eigh(sums.hessian - sums.feigned)
    variance = SIGMA_M**2 * views.factor * max(1, len(views.targets))
    return Aligned(pose, (axes * (np.maximum(values, 0.0) / variance)) @ axes.T)


@numba.njit(cache=True, error_model="numpy")
def tracked_at(
    views: Views, prior: Prior, by: Prior, start: Array, gate_m: float, usual: Usual, is_guess: bool
) -> Tracked:
    """A scan as aligned from a start with the prior `by`, and its log-odds by `prior`; arguments as in `track`."""
    pose, information = aligned(views, by, start, gate_m)
    off = np.array((pose[0] - prior.pose[0], pose[1] - prior.pose[1], wrapped(pose[2] - prior.pose[2])))
    if is_guess:
        off, information = _remapped(information, prior, off)
        x, y, theta = triple(prior.pose)
        pose = np.array((x + off[0], y + off[1], wrapped(theta + off[2])))
    agreed = agreement_of(views, pose)
    judged, share = agreed.hits + agreed.through, contradicted(agreed.hits, agreed.through)
    pull = product(prior.information, off)
    square = off[0] * pull[0] + off[1] * pull[1] + off[2] * pull[2]
    right = 1.0 - max(usual.contradicted, _RARE)
    seen = _log_ratio(agreed.hits / _SURFACE, agreed.through / _SURFACE, right, 1.0 - _THROUGH)
    seen += _log_ratio_of_any(agreed.lines / _SURFACE, (judged - agreed.lines) / _SURFACE, usual.lines, _CHANCE)
    slipping, rolling = _slipping(prior, off), _rolling(square)
    log_odds = max(slipping, rolling) + seen - math.log(_RARE)
    cov, lines = inverse_covariance(added(prior.information, information)), agreed.lines / max(judged, 1.0)
    return Tracked(pose, cov, off, square, log_odds, share, lines, slipping > rolling)


@numba.njit(cache=True, error_model="numpy")
def _remapped(information: Array, prior: Prior, off: Array) -> tuple[Array, Array]:
    """The distance from the prior, and the information, where what few returns observe is left to the prior.

    Along a corridor a few wrong partners hold a scan where it was. Solution remapping, Zhang, Kaess and Singh 2016,
    "On degeneracy of optimization-based state estimation problems", with information in place of a threshold.
    """
    values, axes = np.linalg.eigh(information)
    left = np.maximum(values - 0.5 * FEW_RETURNS / SIGMA_M**2, 0.0)
    told, share = (axes * left) @ axes.T, (axes * (left / np.maximum(values, 1.0))) @ axes.T
    by_scans = product(share, product(added(prior.information, information), off))
    return product(inverse_covariance(added(prior.information, told)), by_scans), told


@numba.njit(cache=True, error_model="numpy")
def _log_ratio(yes: float, no: float, right: float, wrong: float) -> float:
    """Log of the likelihood ratio of counts, for a share `right` at a right pose, which is larger, and `wrong`."""
    right = max(right, wrong)
    return float(yes * math.log(right / wrong) + no * math.log((1.0 - right) / (1.0 - wrong)))


@numba.njit(cache=True, error_model="numpy")
def _log_ratio_of_any(yes: float, no: float, right: float, wrong: float) -> float:
    """As `_log_ratio`, for a share at a right pose that varies about `right` from scan to scan: beta-binomial.

    From farther away fewer returns lie on lines.
    """
    a, b = _VARIES * right, _VARIES * (1.0 - right)
    of_right = math.lgamma(a + yes) - math.lgamma(a) + math.lgamma(b + no) - math.lgamma(b)
    of_right += math.lgamma(_VARIES) - math.lgamma(_VARIES + yes + no)
    return float(of_right - yes * math.log(wrong) - no * math.log(1.0 - wrong))


@numba.njit(cache=True, error_model="numpy")
def _rolling(square: float) -> float:
    """Log density of a motion if the wheels have not slipped, over that of one as predicted: Student's distribution."""
    return -0.5 * (FREEDOM + 3) * math.log1p(square / FREEDOM)


@numba.njit(cache=True, error_model="numpy")
def _slipping(prior: Prior, off: Array) -> float:
    """Log density of a pose that is `off` (3,) if wheels slip, over that of the prior's own pose if they do not."""
    root = whitening(prior.information)
    wider = math.log(SLIP**3) - math.log(root[0, 0] * root[1, 1] * root[2, 2])
    square = (off[0] ** 2 + off[1] ** 2 + off[2] ** 2) / SLIP**2
    return float(math.log(_RARE) - max(wider, 0.0) - 0.5 * square)
