"""Tracking: the pose of a scan among keyframes near it.

Odometry proposes a pose, and the scans correct it. Poses that a scan may have are compared by their probability: that
of the motion, by wheels which sometimes slip, and that of what the scan sees there, by what scans usually see. A scan
may also tell nothing. If that is the likeliest, the scan is searched for in the submap of the last keyframes, and is
left out if no place there is likelier.

How large the errors of the wheels are in this run is learnt from what scans say of their motions. Wheels differ by more
than a factor of ten. What is known of any wheels is where the estimate begins: two factors on the sigmas of that model,
one of position and one of heading, are the maximum of the likelihood of the motions so far. It is found by expectation
maximisation, with Student's distribution in place of the normal one: a motion that a slip has spoilt tells little of
the others (Lange, Little and Taylor, "Robust statistical modeling using the t distribution", JASA 84, 1989).
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
    eigen,
    in_axes,
    inverse,
    inverse_covariance,
    move_covariance,
    product,
    put,
    triple,
    whitening,
    wrapped,
)
from sixthsense.slam.scans.alignment import SIGMA_M, SUMS, Prior, Views, align, solved, told
from sixthsense.slam.scans.links import FEW_RETURNS, NEAR_GATE_M, WIDE_GATE_M
from sixthsense.slam.scans.places import PLACE, VOXEL_M, Window, peaks, pyramid, submap_points
from sixthsense.slam.scans.returns import bearings_at
from sixthsense.slam.scans.visibility import Agreement, contradicted, judged

SLIP_SIGMAS = 6.0
"""scale of the loss on the odometry: wheels slip"""
SLIP_M, SLIP_RAD = 0.5, 0.5
"""sigmas of a motion that the odometry has missed"""
_WEAK = 0.05  # weight of odometry that may have slipped
_DOUBTED = 0.9  # a pose is doubted at which less than this part of what usually agrees does
_SLIPS, _TELLS_NOTHING = 0.01, 0.05  # probability that wheels slip over a motion, and that a scan tells nothing
_CHANCE, _THROUGH = 0.15, 0.4  # share of judged returns that lie on lines, and that are seen through, at a wrong pose
_LEAST_SHARE = 0.01  # that is usually seen through
_NEWEST_SHARE = 0.02  # of the newest scan in what is usual
_SURFACE = 5.0  # neighbouring returns that are of one surface: they tell about a pose together
LEAST_SCORE = 0.3  # share of the returns that a submap must explain where a scan is searched
_MOST = 8  # places in the submap that are looked at
NEAREST = 3  # keyframes that a scan is aligned with at a place
_FEW = 0.5 * FEW_RETURNS  # those of a link count both ways
_LEAST = 1e-3  # 1/m^2, 1/rad^2: information of next to nothing
FREEDOM = 4.0
"""degrees of freedom of Student's distribution of a motion: floors and loads change, wheels slip now and then"""
_PRIOR, _MEMORY = 10.0, 200.0  # motions that the model of any wheels is worth, and that are remembered: floors differ


class WheelNoise:
    """Factors on the sigmas of wheels in general."""

    def __init__(self) -> None:
        self.factors = np.ones(3)
        """(3,) on the sigmas of (x, y, theta)"""
        self._variances = np.ones(2)
        """of position and heading, over those of the model"""
        self._count = _PRIOR

    def measured(self, stated: Array, off: Array, left: Array, heading: float) -> None:
        """Take in a motion whose error is `off` (3,), known up to the covariance `left` (3, 3).

        `stated` (3, 3) is the covariance by the model, in the axes that the motion ends in. Those of the others are
        turned back by `heading`: it is that of the end in them.
        """
        _learn(self._variances, self._count, stated, off, move_covariance((0.0, 0.0, -heading), left), heading)
        self.factors = np.sqrt(self._variances[[0, 0, 1]])
        self._count = min(self._count + 1.0, _MEMORY)


@numba.njit(cache=True, error_model="numpy")
def _learn(variances: Array, count: float, stated: Array, off: Array, left: Array, heading: float) -> None:
    """Move `variances` (2,) by a motion, as the last of `count` others and this one."""
    c, s = math.cos(heading), math.sin(heading)
    x, y = c * off[0] + s * off[1], c * off[1] - s * off[0]
    position = (x * x + left[0, 0]) / stated[0, 0] + (y * y + left[1, 1]) / stated[1, 1]
    turn = (off[2] ** 2 + left[2, 2]) / stated[2, 2]
    for k, n, total in ((0, 2.0, position), (1, 1.0, turn)):
        weight = (FREEDOM + n) / (FREEDOM + total / variances[k])
        variances[k] += (weight * total / n - variances[k]) / (count + 1.0)


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
    """What the odometry since the last keyframe, at `key` (3,) `T_world_laser`, says of the newest scan's pose.

    `since` is the robot's motion from there, `cov` (3, 3) its covariance by wheels in general, `factors` (3,) are on
    the sigmas of those of this run, and `mount` is `T_robot_laser`.
    """
    back, begin, before = inverse(mount), triple(key), triple(last.pose)
    own = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            own[i, j] = cov[i, j] * (factors[i] * factors[j])
    pose = np.array(compose(begin, conjugate(back, since)))
    information = inverse_covariance(move_covariance((0.0, 0.0, pose[2]), move_covariance(back, own)))
    starts, moves = (
        np.empty((3, 3)),
        (conjugate(back, compose(inverse(last.since), since)), last.motion, (0.0, 0.0, 0.0)),
    )
    for k in range(len(moves)):
        starts[k, 0], starts[k, 1], starts[k, 2] = compose(before, moves[k])
    return Expected(Prior(pose, information, SLIP_SIGMAS), starts, move_covariance(back, cov))


@numba.njit(cache=True, error_model="numpy")
def informations_in_world(key_poses: Array, motions: Array, covs: Array, mount: Triple) -> Array:
    """(m, 3, 3) informations, world axes, of the laser's motions from key poses (m, 3), `T_world_laser`.

    `motions` (m, 3) and `covs` (m, 3, 3) are those of the robot, axes after each motion, and `mount` `T_robot_laser`.
    """
    out, back = np.empty((len(covs), 3, 3)), inverse(mount)
    for k in range(len(covs)):
        heading = key_poses[k, 2] + motions[k, 2]
        put(out, k, inverse_covariance(move_covariance((0.0, 0.0, heading), move_covariance(back, covs[k]))))
    return out


class Usual(NamedTuple):
    """What scans lately had where they were tracked."""

    contradicted: float
    """share of returns that contradict, of those that are judged"""
    lines: float
    """share of the same that lie on lines of one keyframe"""


class Aligned(NamedTuple):
    """A scan as aligned with others."""

    pose: Array
    """(3,) of the laser, frame of the others' poses"""
    information: Array
    """(3, 3) of the error of (x, y, theta), same axes, by the scans alone; what the normals' noise adds is left out"""
    off: Array
    """(3,) of the pose from the prior's"""
    slip: float
    """squared Mahalanobis distance of the pose from the prior"""
    support: float
    """share of the returns that lie on lines of one of the others"""
    returns: int
    """of the scan"""
    agreement: Agreement
    """with the others, by visibility"""


class Tracked(NamedTuple):
    """A scan's pose among keyframes, and what it is worth."""

    pose: Array
    """(3,) `T_world_laser`"""
    information: Array
    """(3, 3) of the error of (x, y, theta), world axes, by the scans alone"""
    cov: Array
    """(3, 3) of the same error by scans and odometry together"""
    off: Array
    """(3,) of the pose from the odometry, world axes"""
    slip: float
    """squared Mahalanobis distance of the odometry from the pose"""
    has_slipped: bool
    """whether it is likelier that the wheels have slipped"""
    log_odds: float
    """log of the probability of this pose over that of a motion as predicted whose scan tells nothing"""
    is_doubted: bool
    """whether less agrees than usually"""
    is_firm: bool
    """whether it is where the odometry may well have led to, and is not doubted"""
    is_lost: bool
    """whether it is likelier that the scan tells nothing than that it is from this pose"""
    usual: Usual
    """what scans usually have, this one included"""


@numba.njit(cache=True, error_model="numpy")
def track(views: Views, prior: Prior, starts: Array, usual: Usual, is_guess: bool) -> Tracked:
    """The pose of a scan among keyframes.

    `starts` (n, 3) are poses to begin at, the first by odometry since the scan before. A pose that agrees as usual
    with what is seen and with the wheels is taken at once. Otherwise the other starts are tried with a wide gate, and
    so is the odometry's own pose. `is_guess` is whether nothing has measured the prior.
    """
    best = _judged(aligned(views, prior, starts[0], NEAR_GATE_M), prior, usual, is_guess)
    if best.is_firm:
        return best
    weak = prior.information.copy()
    for i in range(3):
        for j in range(3):
            weak[i, j] *= _WEAK
    by, start, gate_m = Prior(prior.pose, prior.information, np.inf), prior.pose, NEAR_GATE_M
    for k in range(len(starts) + 1):
        if k > 0:
            by, start, gate_m = Prior(prior.pose, weak, prior.slip_sigmas), starts[k - 1], WIDE_GATE_M
        other = _judged(aligned(views, by, start, gate_m), prior, usual, is_guess)
        best = other if is_likelier(other, best) else best
    return best


@numba.njit(cache=True, error_model="numpy")
def is_likelier(one: Tracked, other: Tracked) -> bool:
    """Whether a pose is likelier than another; those that the wheels allow and nothing contradicts come first.

    Someone who walks ahead in a corridor is seen where he was, and nothing contradicts the wheels.
    """
    if one.is_firm != other.is_firm:
        return one.is_firm
    return one.log_odds > other.log_odds


def search(views: Views, prior: Prior, usual: Usual, is_guess: bool) -> Tracked:
    """The pose of a scan in the submap of the targets, where it contradicts them near the odometry."""
    returns, source, targets, at = views.returns, views.source, views.targets, views.at
    own = returns.points[source]
    own = own[own[:, 2] > 0.0, :2].astype(np.float64)
    firm = prior._replace(slip_sigmas=np.inf)
    found = aligned(_nearest(views, prior.pose), firm, prior.pose, NEAR_GATE_M)
    best = _judged(found, prior, usual, is_guess)
    if len(own) and len(targets):
        points = submap_points(returns, targets, between(prior.pose, at), VOXEL_M)
        window = Window(np.zeros(3), SIGNIFICANT * SLIP_M, SIGNIFICANT * SLIP_RAD)
        loose = Prior(prior.pose, np.diag([SLIP_M**-2, SLIP_M**-2, SLIP_RAD**-2]))
        for row in peaks(pyramid(points), own, window, LEAST_SCORE, PLACE, _MOST):
            place = compose(prior.pose, row[1:])
            other = _judged(aligned(_nearest(views, place), loose, place, WIDE_GATE_M), prior, usual, is_guess)
            best = other if is_likelier(other, best) else best
    return best


def _nearest(views: Views, pose: Array) -> Views:
    """The views with the targets that are nearest to a pose."""
    off = views.at - pose
    order = np.argsort(np.hypot(off[:, 0], off[:, 1]) + np.abs(wrap_angle(off[:, 2])), kind="stable")[:NEAREST]
    return views._replace(targets=views.targets[order], at=views.at[order])


def refine(views: Views, prior: Prior) -> Aligned:
    """As `track`, from the prior's pose, which is nearly right."""
    return aligned(views, prior, prior.pose, 0.0)


@numba.njit(cache=True, error_model="numpy")
def aligned(views: Views, prior: Prior, start: Array, gate_m: float) -> Aligned:
    """The pose that a scan is aligned at among others from `start` (3,), with partners up to `gate_m` at first."""
    pose, sums = start.copy(), np.zeros(SUMS)
    most = align(views, prior, gate_m, False, pose, sums)
    off = _off(prior, pose)
    information = told(sums, SIGMA_M**2 * views.factor * max(1, len(views.targets)))
    count, bearings = 0, bearings_at(views.returns, views.source)
    for k in range(0, views.returns.points.shape[1], bearings.stride):
        count += views.returns.points[views.source, k, 2] != 0.0
    hits, violations = judged(views, pose)
    slip = _square(prior.information, off)
    return Aligned(pose, information, off, slip, most / max(count, 1), count, Agreement(hits, violations))


@numba.njit(cache=True, error_model="numpy")
def _off(prior: Prior, pose: Array) -> Array:
    return np.array((pose[0] - prior.pose[0], pose[1] - prior.pose[1], wrapped(pose[2] - prior.pose[2])))


@numba.njit(cache=True, error_model="numpy")
def _square(information: Array, off: Array) -> float:
    """Squared Mahalanobis distance."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += off[i] * information[i, j] * off[j]
    return total


@numba.njit(cache=True, error_model="numpy")
def _judged(found: Aligned, prior: Prior, usual: Usual, is_guess: bool) -> Tracked:
    """What an aligned pose is worth beside a prior; remapped if that is a guess."""
    hits, through = found.agreement
    slip, slipping = _square(prior.information, found.off), _slipping(prior, found.off)
    # Of those that are judged, the returns that lie on lines of one keyframe.
    judged = hits + through
    lines = min(found.support * found.returns, judged)
    told = _log_ratio(hits, through, 1.0 - max(usual.contradicted, _LEAST_SHARE), 1.0 - _THROUGH)
    # From farther away fewer returns lie on lines than usually: that is no evidence against a pose.
    told += _log_ratio(lines, judged - lines, min(lines / max(judged, 1.0), usual.lines), _CHANCE)
    log_odds = max(slipping, _rolling(slip)) + told / _SURFACE - math.log(_TELLS_NOTHING)
    share = contradicted(hits, through)
    is_doubted = share > 1.0 - _DOUBTED * (1.0 - usual.contradicted)
    is_firm = slip <= SLIP_SIGMAS**2 and not is_doubted
    pose, off, (values, axes) = found.pose, found.off, eigen(found.information)
    information = found.information
    if values[0] < 0.0:  # which is rounding
        information = in_axes(_at_least(values, 0.0), axes)
    if is_guess:
        off, information = _remapped(values, axes, prior, off)
        x, y, theta = triple(prior.pose)
        pose = np.array((x + off[0], y + off[1], wrapped(theta + off[2])))
        slip, slipping = _square(prior.information, off), _slipping(prior, off)
    cov = inverse_covariance(added(prior.information, information))
    newest = Usual(
        usual.contradicted + _NEWEST_SHARE * (share - usual.contradicted),
        usual.lines + _NEWEST_SHARE * (lines / max(judged, 1.0) - usual.lines),
    )
    has_slipped = slipping > _rolling(slip)
    is_lost = log_odds < 0.0
    return Tracked(pose, information, cov, off, slip, has_slipped, log_odds, is_doubted, is_firm, is_lost, newest)


@numba.njit(cache=True, error_model="numpy")
def _remapped(values: Array, axes: Array, prior: Prior, off: Array) -> tuple[Array, Array]:
    """The distance from the prior, and the information, where what few returns tell of is left to the prior.

    `values` (3,) and `axes` (3, 3), in columns, are those of the information.

    Along a corridor a few wrong partners hold a scan where it was. Solution remapping, Zhang, Kaess and Singh 2016,
    "On degeneracy of optimization-based state estimation problems", with information in place of a threshold.
    """
    values, left, share = _at_least(values, _LEAST), np.empty(3), np.empty(3)
    for i in range(3):
        left[i] = max(values[i] - _FEW / SIGMA_M**2, 0.0)
        share[i] = left[i] / values[i]
    information = in_axes(left, axes)
    by_scans = product(in_axes(share, axes), product(added(prior.information, in_axes(values, axes)), off))
    return solved(added(prior.information, information), by_scans), information


@numba.njit(cache=True, error_model="numpy")
def _at_least(values: Array, least: float) -> Array:
    """(3,) numbers, those below a limit at it."""
    return np.array((max(values[0], least), max(values[1], least), max(values[2], least)))


@numba.njit(cache=True, error_model="numpy")
def _log_ratio(yes: float, no: float, right: float, wrong: float) -> float:
    """Log of the likelihood ratio of counts, for a share `right` at a right pose, which is larger, and `wrong`."""
    right = max(right, wrong)
    return float(yes * math.log(right / wrong) + no * math.log((1.0 - right) / (1.0 - wrong)))


@numba.njit(cache=True, error_model="numpy")
def _rolling(square: float) -> float:
    """Log density of a motion if the wheels have not slipped, over that of one as predicted: Student's distribution."""
    return -0.5 * (FREEDOM + 3) * math.log1p(square / FREEDOM)


@numba.njit(cache=True, error_model="numpy")
def _slipping(prior: Prior, off: Array) -> float:
    """Log density of a pose that is `off` (3,) if wheels slip, over that of the prior's own pose if they do not."""
    root = whitening(prior.information)
    wider = math.log(SLIP_M * SLIP_M * SLIP_RAD) - math.log(root[0, 0] * root[1, 1] * root[2, 2])
    square = (off[0] / SLIP_M) ** 2 + (off[1] / SLIP_M) ** 2 + (off[2] / SLIP_RAD) ** 2
    return float(math.log(_SLIPS) - max(wider, 0.0) - 0.5 * square)
