"""Tracking: the pose of a scan among keyframes near it, with the odometry as a prior that can lose."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.slam.scans.alignment import (
    GRADIENT,
    HESSIAN,
    SPREAD,
    SUMS,
    WEIGHT,
    Loss,
    add_one_way,
    next_step,
    on_line,
    solved,
    turned,
)
from sixthsense.slam.scans.scan_store import Returns

_SIGMA_M = 0.03  # of a point's distance from a line: noise, roughness and curvature of real walls
_SCALE_M = 0.05  # of the loss on these distances
_GATES_M = np.array([0.25, 0.2, 0.15, *[0.12] * 9])
_WIDE_GATES_M = np.array([0.5, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.15, *[0.12] * 6])
_LAST_GATES_M = np.array([0.12] * 6)
_STEP_M, _STEP_RAD = 5e-4, 2e-4  # smaller steps end the iteration
SLIP_SIGMAS = 6.0  # scale of the loss on the odometry: wheels slip
_POOR_SUPPORT, _DROP = 0.35, 0.1  # share of returns on known lines, and below the usual, at which slip is suspected
_GAIN, _GAIN_OF_TURN = 0.03, 0.15  # by how much another start, and another heading, must raise it
_GAIN_OF_SLIP = 0.1  # by how much a pose that contradicts the odometry must raise the share of returns on any line
_WEAK = 0.05  # weight of odometry that is under suspicion
_OTHER_HEADINGS_RAD = (0.15, -0.15, 0.3, -0.3, 0.5, -0.5)


class Prior(NamedTuple):
    """What the odometry says about a pose."""

    pose: Array
    """(3,) world frame"""
    information: Array
    """(3, 3) of the error of (x, y, theta), world axes"""
    slip_sigmas: float = SLIP_SIGMAS
    """scale of the loss on the distance from it"""

    def doubted(self) -> Prior:
        """The prior with the weight of odometry that is under suspicion."""
        return self._replace(information=_WEAK * self.information)

    def firm(self) -> Prior:
        """The prior without a loss: wheels do not slip."""
        return self._replace(slip_sigmas=math.inf)


class Views(NamedTuple):
    """A scan and the keyframes that it is aligned with."""

    returns: Returns
    source: int
    """row of the scan"""
    references: NDArray[np.int64]
    """(R,) rows of the keyframes"""
    poses: Array
    """(n, 3) of keyframes, `T_world_laser`"""


class Tracked(NamedTuple):
    """A scan's pose among keyframes."""

    pose: Array
    """(3,) `T_world_laser`"""
    information: Array
    """(3, 3) of the error of (x, y, theta), world axes: by the scans alone, without what normals' noise feigns"""
    support: float
    """share of the returns that lie on lines of one keyframe"""
    slip: float
    """squared Mahalanobis distance of the odometry from the pose"""
    off: Array
    """(3,) of the pose from the odometry, world axes"""

    def judged_by(self, prior: Prior) -> Tracked:
        """The same, with the slip by another prior of the same pose."""
        return self._replace(slip=float(self.off @ prior.information @ self.off))


def track(views: Views, prior: Prior, starts: Array, usual: float) -> Tracked:
    """The pose of a scan among keyframes.

    `starts` (n, 3) are poses to begin at, the first by odometry since the scan before. `usual` is the support that
    scans have lately had. Where fewer returns find a line, wheels may have slipped: the other starts are tried, with
    partners farther away; where few do, at other headings, too. What explains clearly more is taken. A pose that
    contradicts the odometry must explain clearly more than one that does not: along a corridor, what has come into
    view lately, or moves, would slide the scan.
    """
    best = _best_of(views, prior, starts, usual)
    if best.slip <= SLIP_SIGMAS**2:
        return best
    firm = _solved(views, prior.firm(), prior.pose, _GATES_M)
    if firm.slip > SLIP_SIGMAS**2:
        return best
    with_slip, without = (share_on_lines(*views, found.pose) for found in (best, firm))
    return best if with_slip > without + _GAIN_OF_SLIP else firm


def _best_of(views: Views, prior: Prior, starts: Array, usual: float) -> Tracked:
    """The pose that explains most, from one of the starts."""
    best = _solved(views, prior, starts[0], _GATES_M)
    if best.support >= max(usual - _DROP, _POOR_SUPPORT):
        return best
    tried = prior.doubted()
    for start in starts:
        other = _solved(views, tried, start, _WIDE_GATES_M)
        if other.support > best.support + _GAIN:
            best = other.judged_by(prior)
    if best.support >= _POOR_SUPPORT:
        return best
    least = best.support + _GAIN_OF_TURN
    for turn, start in itertools.product(_OTHER_HEADINGS_RAD, starts):
        turned = start + np.array([0.0, 0.0, turn])
        other = _solved(views, tried, turned, _WIDE_GATES_M)
        if other.support > least:
            best, least = other.judged_by(prior), other.support
    return best


def refine(views: Views, prior: Prior) -> Tracked:
    """As `track`, from the prior's pose, which is nearly right."""
    return _solved(views, prior, prior.pose, _LAST_GATES_M)


def _solved(views: Views, prior: Prior, start: Array, gates_m: Array) -> Tracked:
    pose, information = np.array(start, dtype=np.float64), np.zeros((3, 3))
    support = _iterate(*views, prior, gates_m, pose, information)
    pose[2] = wrap_angle(float(pose[2]))
    off = pose - prior.pose
    off[2] = wrap_angle(float(off[2]))
    return Tracked(pose, information, support, float(off @ prior.information @ off), off)


@numba.njit(cache=True, error_model="numpy")
def share_on_lines(returns: Returns, source: int, references: NDArray[np.int64], poses: Array, pose: Array) -> float:
    """Share of the returns of `source`, at `pose` (3,), that lie on a line of any of the keyframes `references` (R,).

    The support counts one keyframe at a time, and so less where each of them has seen another part.
    """
    points, bearings = returns.points, returns.bearings
    total, count = 0.0, 0
    for k in range(0, bearings.beams, bearings.stride):
        if points[source, k, 2] == 0.0:
            continue
        count += 1
        c, s = math.cos(pose[2]), math.sin(pose[2])
        wx = pose[0] + c * points[source, k, 0] - s * points[source, k, 1]
        wy = pose[1] + s * points[source, k, 0] + c * points[source, k, 1]
        most = 0.0
        for target in references:
            c, s = math.cos(poses[target, 2]), math.sin(poses[target, 2])
            dx, dy = wx - poses[target, 0], wy - poses[target, 1]
            turn = pose[2] - poses[target, 2]
            most = max(most, on_line(returns, target, source, k, turn, c * dx + s * dy, c * dy - s * dx))
        total += most
    return total / max(count, 1)


@numba.njit(cache=True, error_model="numpy")
def _iterate(
    returns: Returns,
    source: int,
    references: NDArray[np.int64],
    poses: Array,
    prior: Prior,
    gates_m: Array,
    pose: Array,
    information: Array,
) -> float:
    """Gauss-Newton steps from and into `pose` (3,); fills `information` (3, 3) and returns the support."""
    count = 0
    for k in range(0, returns.bearings.beams, returns.bearings.stride):
        count += returns.points[source, k, 2] > 0.0
    support = 0.0
    step = 0
    while step < len(gates_m):
        hessian, gradient, feigned = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
        most = 0.0
        for target in references:
            c, s = math.cos(poses[target, 2]), math.sin(poses[target, 2])
            dx, dy = pose[0] - poses[target, 0], pose[1] - poses[target, 1]
            seen = np.array([c * dx + s * dy, c * dy - s * dx, pose[2] - poses[target, 2]])
            sums = np.zeros(SUMS)
            add_one_way(returns, target, source, seen, Loss(gates_m[step], _SCALE_M), sums)
            hessian += turned(sums, HESSIAN, c, s)
            feigned += turned(sums, SPREAD, c, s)
            gx, gy = sums[GRADIENT], sums[GRADIENT + 1]
            gradient += np.array([c * gx - s * gy, s * gx + c * gy, sums[GRADIENT + 2]])
            most = max(most, sums[WEIGHT])
        # Keyframes see the same surfaces: together they count as one.
        scale = 1.0 / (_SIGMA_M * _SIGMA_M * max(1, len(references)))
        off = pose - prior.pose
        off[2] = (off[2] + math.pi) % (2.0 * math.pi) - math.pi
        pull = prior.information @ off
        weight = 1.0 / (1.0 + off @ pull / (prior.slip_sigmas * prior.slip_sigmas))
        move = solved(scale * hessian + weight * prior.information, -(scale * gradient + weight * pull))
        pose += move
        support = most / max(count, 1)
        information[:] = scale * (hessian - feigned)
        shift, turn = abs(move[0]) + abs(move[1]), abs(move[2])
        if gates_m[step] == gates_m[-1] and shift < _STEP_M and turn < _STEP_RAD:
            break
        step = next_step(step, gates_m, shift, turn)
    return support
