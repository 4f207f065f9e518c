"""Tracking: the pose of a scan among keyframes near it.

Odometry proposes a pose, and the scans correct it. Visibility judges: a pose is contradicted by returns that other
scans saw through. Wheels are believed to have slipped only where their pose is contradicted and another one is not.
Where every pose near the odometry's is contradicted, the scan is searched for in the submap of the last keyframes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.alignment import HESSIAN, SIGMA_M, SPREAD, SUMS, Prior, Views, align, matrix
from sixthsense.slam.scans.links import FEW_RETURNS, NEAR_GATE_M, WIDE_GATE_M
from sixthsense.slam.scans.places import PLACE, VOXEL_M, Window, peaks, pyramid, submap_points
from sixthsense.slam.scans.returns import bearings_at
from sixthsense.slam.scans.visibility import Agreement, judged

SLIP_SIGMAS = 6.0
"""scale of the loss on the odometry: wheels slip"""
SLIP_M, SLIP_RAD = 0.5, 0.5
"""sigmas of a motion that the odometry has missed"""
_WEAK = 0.05  # weight of odometry that may have slipped
_DOUBTED, _LOST = 0.9, 0.5  # a pose is doubted, or lost, at which less than this part of what usually agrees does
_CLEARLY = 0.5  # another pose must leave at most this part of what contradicts
_SEARCHED_SIGMAS = 3.0  # half the side of the window that is searched
LEAST_SCORE = 0.3  # share of the returns that a submap must explain where a scan is searched
_MOST = 8  # places in the submap that are looked at
NEAREST = 3  # keyframes that a scan is aligned with at a place
_FEW = 0.5 * FEW_RETURNS  # those of a link count both ways
_LEAST = 1e-3  # 1/m^2, 1/rad^2: information of next to nothing


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

    @property
    def has_slipped(self) -> bool:
        """Whether the pose contradicts the odometry."""
        return self.slip > SLIP_SIGMAS**2

    def is_lost(self, usual: float) -> bool:
        """Whether much less agrees than usually; `usual` is the share that usually contradicts."""
        return self.agreement.share > 1.0 - _LOST * (1.0 - usual)

    def is_doubted(self, usual: float) -> bool:
        """Whether less agrees than usually, as `is_lost`."""
        return self.agreement.share > _doubt(usual)

    def judged_by(self, prior: Prior) -> Tracked:
        """The same, with the slip by another prior of the same pose."""
        return self._replace(slip=prior.squared(self.off))

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
        return self._replace(pose=pose, information=information, slip=prior.squared(off), off=off)


def track(views: Views, prior: Prior, starts: Array, usual: float) -> Tracked:
    """The pose of a scan among keyframes.

    `starts` (n, 3) are poses to begin at, the first by odometry since the scan before. `usual` is the share of returns
    that usually contradict: people, glass, noise. A pose that does not is taken at once. Otherwise the other starts are
    tried with a wide gate, and so is the odometry's own pose: its wheels are right unless it is contradicted.
    """
    found = aligned(views, prior, starts[0], NEAR_GATE_M)
    if not found.has_slipped and found.agreement.share <= _doubt(usual):
        return found
    firm = aligned(views, prior._replace(slip_sigmas=np.inf), prior.pose, NEAR_GATE_M)
    tried = prior._replace(information=_WEAK * prior.information)
    others = [aligned(views, tried, start, WIDE_GATE_M).judged_by(prior) for start in starts]
    return _chosen([found, firm, *others], usual)


def search(views: Views, prior: Prior, usual: float) -> Tracked:
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


def _doubt(usual: float) -> float:
    """The share of contradicting returns from which on a pose is doubted."""
    return 1.0 - _DOUBTED * (1.0 - usual)


def _chosen(found: list[Tracked], usual: float) -> Tracked:
    """The pose that the odometry allows, unless it is contradicted and another one clearly less."""
    allowed = [each for each in found if not each.has_slipped]
    best = min(found, key=lambda each: each.agreement.share)
    if not allowed:
        return best
    firm = min(allowed, key=lambda each: each.agreement.share)
    less = best.agreement.share < _CLEARLY * firm.agreement.share and best.agreement.hits >= firm.agreement.hits
    return best if firm.agreement.share > _doubt(usual) and less else firm


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
    support = most / max(int(np.count_nonzero(ranges)), 1)
    return Tracked(pose, information, support, prior.squared(off), off, Agreement(*judged(views, pose)))
