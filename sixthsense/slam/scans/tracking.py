"""Tracking: the pose of a scan among keyframes near it.

Odometry proposes a pose, and the scans correct it. Poses that a scan may have are compared by their probability: that
of the motion, by wheels which sometimes slip, and that of what the scan sees there, by what scans usually see. A scan
may also tell nothing. If that is the likeliest, the scan is searched for in the submap of the last keyframes, and is
left out if no place there is likelier.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.alignment import HESSIAN, SIGMA_M, SPREAD, SUMS, Prior, Views, align, matrix
from sixthsense.slam.scans.links import FEW_RETURNS, NEAR_GATE_M, WIDE_GATE_M
from sixthsense.slam.scans.places import PLACE, VOXEL_M, Window, peaks, pyramid, submap_points
from sixthsense.slam.scans.returns import bearings_at
from sixthsense.slam.scans.visibility import Agreement, judged
from sixthsense.slam.scans.wheel_noise import FREEDOM

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
_SEARCHED_SIGMAS = 3.0  # half the side of the window that is searched
LEAST_SCORE = 0.3  # share of the returns that a submap must explain where a scan is searched
_MOST = 8  # places in the submap that are looked at
NEAREST = 3  # keyframes that a scan is aligned with at a place
_FEW = 0.5 * FEW_RETURNS  # those of a link count both ways
_LEAST = 1e-3  # 1/m^2, 1/rad^2: information of next to nothing


class Usual(NamedTuple):
    """What scans lately had where they were tracked."""

    contradicted: float
    """share of returns that contradict, of those that are judged"""
    lines: float
    """share of the same that lie on lines of one keyframe"""

    def with_scan(self, tracked: Tracked) -> Usual:
        """The same, with one scan more."""
        judged = max(tracked.agreement.hits + tracked.agreement.violations, 1.0)
        newest = np.array([tracked.agreement.share, tracked.lines / judged])
        return Usual(*(np.array(self) + _NEWEST_SHARE * (newest - np.array(self))).tolist())


class Tracked(NamedTuple):
    """A scan's pose among keyframes."""

    pose: Array
    """(3,) `T_world_laser`"""
    information: Array
    """(3, 3) of the error of (x, y, theta), world axes, by the scans alone; what the normals' noise adds is left out"""
    support: float
    """share of the returns that lie on lines of one keyframe"""
    slip: float
    """squared Mahalanobis distance of the odometry from the pose"""
    off: Array
    """(3,) of the pose from the odometry, world axes"""
    agreement: Agreement
    """with the keyframes, by visibility"""
    returns: int
    """of the scan"""
    slipping: float
    """log density of the motion if the wheels have slipped, over that of a motion as predicted if they have not"""

    @property
    def lines(self) -> float:
        """Returns that lie on lines of one keyframe, of those that are judged."""
        return min(self.support * self.returns, self.agreement.hits + self.agreement.violations)

    @property
    def is_near(self) -> bool:
        """Whether it is where the odometry may well have led to."""
        return self.slip <= SLIP_SIGMAS**2

    @property
    def has_slipped(self) -> bool:
        """Whether it is likelier that the wheels have slipped."""
        return self.slipping > _rolling(self.slip)

    def log_odds(self, usual: Usual) -> float:
        """Log of the probability of this pose over that of a motion as predicted whose scan tells nothing."""
        hits, through = self.agreement
        told = _log_ratio(hits, through, 1.0 - max(usual.contradicted, _LEAST_SHARE), 1.0 - _THROUGH)
        # From farther away fewer returns lie on lines than usually: that is no evidence against a pose.
        share = self.lines / max(hits + through, 1.0)
        told += _log_ratio(self.lines, hits + through - self.lines, min(share, usual.lines), _CHANCE)
        return max(self.slipping, _rolling(self.slip)) + told / _SURFACE - math.log(_TELLS_NOTHING)

    def is_lost(self, usual: Usual) -> bool:
        """Whether it is likelier that the scan tells nothing than that it is from this pose."""
        return self.log_odds(usual) < 0.0

    def is_doubted(self, usual: Usual) -> bool:
        """Whether less agrees than usually."""
        return self.agreement.share > 1.0 - _DOUBTED * (1.0 - usual.contradicted)

    def judged_by(self, prior: Prior) -> Tracked:
        """The same, by another prior of the same pose."""
        return self._replace(slip=prior.squared(self.off), slipping=_slipping(prior, self.off))

    def remapped(self, prior: Prior) -> Tracked:
        """The same, where a direction of which only a few returns tell is left to the prior.

        Along a corridor a few wrong partners hold a scan where it was. Solution remapping, Zhang, Kaess and Singh 2016,
        "On degeneracy of optimization-based state estimation problems", with information in place of a threshold.
        """
        values, axes = np.linalg.eigh(self.information)
        values = np.maximum(values, _LEAST)
        told = np.maximum(values - _FEW / SIGMA_M**2, 0.0)
        information, share = (axes * told) @ axes.T, (axes * (told / values)) @ axes.T
        by_scans = share @ (prior.information + (axes * values) @ axes.T) @ self.off
        off = np.linalg.solve(prior.information + information, by_scans)
        pose = prior.pose + off
        pose[2] = wrap_angle(float(pose[2]))
        return self._replace(pose=pose, information=information, off=off).judged_by(prior)


def track(views: Views, prior: Prior, starts: Array, usual: Usual) -> Tracked:
    """The pose of a scan among keyframes.

    `starts` (n, 3) are poses to begin at, the first by odometry since the scan before. A pose that agrees as usual
    with what is seen and with the wheels is taken at once. Otherwise the other starts are tried with a wide gate, and
    so is the odometry's own pose.
    """
    found = aligned(views, prior, starts[0], NEAR_GATE_M)
    if found.is_near and not found.is_doubted(usual):
        return found
    firm = aligned(views, prior._replace(slip_sigmas=np.inf), prior.pose, NEAR_GATE_M)
    tried = prior._replace(information=_WEAK * prior.information)
    others = [aligned(views, tried, start, WIDE_GATE_M).judged_by(prior) for start in starts]
    return _chosen([found, firm, *others], usual)


def search(views: Views, prior: Prior, usual: Usual) -> Tracked:
    """The pose of a scan in the submap of the targets, where it contradicts them near the odometry."""
    returns, source, targets, at = views
    own = returns.points[source]
    own = own[own[:, 2] > 0.0, :2].astype(np.float64)
    found = [aligned(_nearest(views, prior.pose), prior._replace(slip_sigmas=np.inf), prior.pose, NEAR_GATE_M)]
    if len(own) and len(targets):
        points = submap_points(returns, targets, between(prior.pose, at), VOXEL_M)
        window = Window(np.zeros(3), _SEARCHED_SIGMAS * SLIP_M, _SEARCHED_SIGMAS * SLIP_RAD)
        loose = Prior(prior.pose, np.diag([SLIP_M**-2, SLIP_M**-2, SLIP_RAD**-2]))
        for row in peaks(pyramid(points), own, window, LEAST_SCORE, PLACE, _MOST):
            place = compose(prior.pose, row[1:])
            found.append(aligned(_nearest(views, place), loose, place, WIDE_GATE_M).judged_by(prior))
    return _chosen(found, usual)


def _nearest(views: Views, pose: Array) -> Views:
    """The views with the targets that are nearest to a pose."""
    off = views.at - pose
    order = np.argsort(np.hypot(off[:, 0], off[:, 1]) + np.abs(wrap_angle(off[:, 2])), kind="stable")[:NEAREST]
    return views._replace(targets=views.targets[order], at=views.at[order])


def _chosen(found: list[Tracked], usual: Usual) -> Tracked:
    """The likeliest pose, among those that the wheels allow and nothing contradicts if there are any.

    Someone who walks ahead in a corridor is seen where he was, and nothing contradicts the wheels.
    """
    firm = [each for each in found if each.is_near and not each.is_doubted(usual)]
    return max(firm or found, key=lambda each: each.log_odds(usual))


def _log_ratio(yes: float, no: float, right: float, wrong: float) -> float:
    """Log of the likelihood ratio of counts, for a share `right` at a right pose, which is larger, and `wrong`."""
    right = max(right, wrong)
    return yes * math.log(right / wrong) + no * math.log((1.0 - right) / (1.0 - wrong))


def _rolling(square: float) -> float:
    """Log density of a motion if the wheels have not slipped, over that of one as predicted: Student's distribution."""
    return -0.5 * (FREEDOM + 3.0) * math.log1p(square / FREEDOM)


def _slipping(prior: Prior, off: Array) -> float:
    """Log density of a pose that is `off` (3,) if wheels slip, over that of the prior's own pose if they do not."""
    slip = np.array([SLIP_M, SLIP_M, SLIP_RAD])
    wider = 0.5 * float(np.linalg.slogdet(prior.information)[1]) + float(np.log(slip).sum())
    return math.log(_SLIPS) - max(wider, 0.0) - 0.5 * float(((off / slip) ** 2).sum())


def refine(views: Views, prior: Prior) -> Tracked:
    """As `track`, from the prior's pose, which is nearly right."""
    return aligned(views, prior, prior.pose, 0.0)


def aligned(views: Views, prior: Prior, start: Array, gate_m: float) -> Tracked:
    """The pose that a scan is aligned at among others from `start` (3,), with partners up to `gate_m` at first."""
    pose, sums = np.array(start, dtype=np.float64), np.zeros(SUMS)
    most = align(views, prior, gate_m, False, pose, sums)
    off = pose - prior.pose
    off[2] = wrap_angle(float(off[2]))
    information = (matrix(sums, HESSIAN) - matrix(sums, SPREAD)) / (SIGMA_M**2 * max(1, len(views.targets)))
    ranges = views.returns.points[views.source, :: bearings_at(views.returns, views.source).stride, 2]
    count = int(np.count_nonzero(ranges))
    agreement, slipping = Agreement(*judged(views, pose)), _slipping(prior, off)
    return Tracked(pose, information, most / max(count, 1), prior.squared(off), off, agreement, count, slipping)
