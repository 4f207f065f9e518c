"""Normals, sums of alignments and what scans see of each other, against plain loops over returns."""

import math

import numpy as np
import pytest
from rooms import HALF, ROOM, ROUND, scan_at, stored

from sixthsense.core.geometry import Pose
from sixthsense.slam.scans.alignment import (
    GRADIENT,
    HESSIAN,
    HITS,
    SPREAD,
    SQUARES,
    SUMS,
    WEIGHT,
    Loss,
    Prior,
    Views,
    add_all,
    align,
    matrix,
    partners_of,
)
from sixthsense.slam.scans.links import covariances
from sixthsense.slam.scans.loop_closures import _DRIFT_M, _DRIFT_RAD, _step_variances
from sixthsense.slam.scans.returns import Bearings, bearings_at, fit_normals
from sixthsense.slam.scans.visibility import SURFACE, THROUGH, UNSEEN, judged, look_at

LASERS = pytest.mark.parametrize("laser", [ROUND, HALF], ids=["full circle", "half circle"])
POSES = [Pose(-0.4, 0.3, 0.2), Pose(-0.7, -0.1, -0.3), Pose(-0.15, 0.4, 0.45)]
AT = np.array([[0.9, -1.2, 2.1], *[(Pose(0.9, -1.2, 2.1) @ POSES[0].inverse() @ POSES[1]).array()]])
"""poses of the first two, in a frame of their own"""
SOUGHT = Pose(*AT[0]) @ POSES[0].inverse() @ POSES[2] @ Pose(0.02, -0.015, 0.012)


def views(laser):
    rng = np.random.default_rng(4)
    returns = stored(*(scan_at(pose, ROOM, laser, rng=rng) for pose in POSES)).returns
    return Views(returns, 2, np.arange(2), AT)


def plain_sums(seen, pose, loss, both):
    """The sums of `add_all` with the same partners: of each residual's value and derivatives by finite differences."""
    returns, sums, most = seen.returns, np.zeros(SUMS), 0.0
    points, normals = returns.points.astype(float), returns.normals.astype(float)
    for target, at in zip(seen.targets, seen.at, strict=True):
        own = np.zeros(SUMS)
        relative = (Pose(*at).inverse() @ Pose(*pose)).array()
        ways = [(target, seen.source, relative)]
        if both:
            ways.append((seen.source, target, Pose(*relative).inverse().array()))
        for onto, moved, way in ways:
            partners, shared = partners_of(returns, onto, moved, way, loss.gate_m)
            for i in np.flatnonzero(partners >= 0):
                q, point = partners[i], points[moved, i * bearings_at(returns, moved).stride, :2]
                n = normals[onto, q, :2]

                def off(x, n, onto=onto, point=point, q=q, at=at):
                    T = Pose(*at).inverse() @ Pose(*x)
                    seen_there = (T if onto != 2 else T.inverse()) @ point
                    return n @ (seen_there - points[onto, q, :2])

                rows = [[(off(pose + h, line) - off(pose - h, line)) / 2e-6 for h in 1e-6 * np.eye(3)]
                        for line in (n, np.array([-n[1], n[0]]))]  # fmt: skip
                row, quarter = np.array(rows)
                r, pairs = off(pose, n), 2.0 / (1.0 + shared[q])
                weight = pairs / (1.0 + (r / loss.scale_m) ** 2)
                own[HESSIAN:GRADIENT] += weight * np.outer(row, row)[np.triu_indices(3)]
                own[GRADIENT:WEIGHT] += weight * row * r
                own[[WEIGHT, HITS, SQUARES]] += weight, pairs, weight * r * r
                own[SPREAD:] += weight * normals[onto, q, 2] * np.outer(quarter, quarter)[np.triu_indices(3)]
        sums, most = sums + own, max(most, own[WEIGHT])
    return sums, most


@LASERS
@pytest.mark.parametrize("both", [False, True])
def test_sums_over_several_scans_are_those_of_their_residuals(laser, both):
    seen, sums, loss = views(laser), np.zeros(SUMS), Loss(0.2, 0.04)
    most = add_all(seen, SOUGHT.array(), loss, both, sums)
    expected, largest = plain_sums(seen, SOUGHT.array(), loss, both)
    assert sums[HITS] > 150 and most == pytest.approx(largest, rel=1e-4)
    assert sums == pytest.approx(expected, rel=1e-4, abs=1e-4 * sums[WEIGHT])


@LASERS
@pytest.mark.parametrize("slip_sigmas", [math.inf, 2.0])
def test_an_aligned_pose_balances_the_scans_and_what_was_known_before(laser, slip_sigmas):
    seen, sums, root = (
        views(laser),
        np.zeros(SUMS),
        np.array([[300.0, 40.0, 9.0], [0.0, 200.0, 30.0], [0.0, 0.0, 400.0]]),
    )
    prior = Prior((SOUGHT @ Pose(0.01, 0.02, 0.01)).array() + np.array([0.0, 0.0, 2.0 * math.pi]), root.T @ root,
                  slip_sigmas)  # fmt: skip
    pose = SOUGHT.array()
    align(seen, prior, 0.3, True, pose, sums)
    add_all(seen, pose, Loss(0.12, 0.05), True, sums)
    off = pose - prior.pose + np.array([0.0, 0.0, 2.0 * math.pi])
    slip = 1.0 / (1.0 + off @ prior.information @ off / slip_sigmas**2)
    pull = slip * prior.information @ off
    of_scans = sums[GRADIENT:WEIGHT] / (0.03**2 * 2)  # two scans that see the same surfaces count once
    step = np.linalg.solve(matrix(sums, HESSIAN) / (0.03**2 * 2) + slip * prior.information, of_scans + pull)
    assert np.linalg.norm(pull) > 100.0 and np.abs(step).max() < 5e-4
    assert np.linalg.norm(of_scans + pull) < 0.05 * np.linalg.norm(pull)


@LASERS
def test_what_a_scan_saw_at_a_place_is_that_of_the_three_beams_around_it(laser):
    seen = views(laser)
    points, bearings = seen.returns.points[0].astype(float), bearings_at(seen.returns, 0)
    found = {UNSEEN: 0, THROUGH: 0, SURFACE: 0}
    for x, y in np.random.default_rng(2).uniform(-5.0, 5.0, (600, 2)):
        cell = ((math.atan2(y, x) - bearings.first) % (2.0 * math.pi)) / bearings.spacing
        if abs(cell % 1.0 - 0.5) < 0.01:
            continue  # between two beams either may be the nearest
        beams = round(cell) + np.arange(-1, 2)
        is_blind = not bearings.closed and (beams[0] < 0 or beams[2] >= bearings.beams)
        around = points[beams % bearings.beams]
        around = around[around[:, 2] > 0.0]
        away = np.minimum(np.hypot(*(around[:, :2] - (x, y)).T), np.abs(around[:, 2] - math.hypot(x, y)))
        expected = UNSEEN
        if not is_blind and len(around):
            is_through = math.hypot(x, y) < around[:, 2].min() - 0.24
            expected = SURFACE if away.min() < 0.12 else THROUGH if is_through else UNSEEN
        assert look_at(seen.returns, 0, x, y) == expected
        found[expected] += 1
    assert min(found.values()) > 20


@LASERS
def test_returns_are_judged_both_ways_and_those_of_the_scan_once(laser):
    seen, pose = views(laser), (SOUGHT @ Pose(0.25, -0.1, 0.2)).array()
    points, stride = seen.returns.points.astype(float), bearings_at(seen.returns, 0).stride
    hits = violations = 0.0
    best = np.zeros(points.shape[1])
    for target, at in zip(seen.targets, seen.at, strict=True):
        T = Pose(*at).inverse() @ Pose(*pose)
        for k in range(0, points.shape[1], stride):
            if points[2, k, 2] > 0.0:
                best[k] = max(best[k], look_at(seen.returns, target, *(T @ points[2, k, :2])))
            if points[target, k, 2] > 0.0:
                saw = look_at(seen.returns, 2, *(T.inverse() @ points[target, k, :2]))
                hits, violations = hits + (saw == SURFACE) / 2.0, violations + (saw == THROUGH) / 2.0
    expected = 0.5 * (hits + (best == SURFACE).sum()), 0.5 * (violations + (best == THROUGH).sum())
    assert judged(seen, pose) == pytest.approx(expected) and min(expected) > 5.0


def plain_normal(returns, i, low, high, reach_m):
    """Normal and variance of return `i` of a piece, by returns to either side up to a distance; None without one."""
    away = np.hypot(*(returns[low:high, :2] - returns[i, :2]).T)
    # Up to that distance and the first return beyond, but two returns at least.
    first = max([k for k in range(low, i - 1) if away[k - low] > reach_m], default=low)
    past = min([k for k in range(i + 2, high) if away[k - low] > reach_m], default=high - 1) + 1
    points = returns[first:past, :2].astype(float)
    if len(points) < (3 if first < i < past - 1 else 4):
        return None
    values, axes = np.linalg.eigh(np.cov(points.T, bias=True))
    n = axes[:, 0] * -np.sign(axes[:, 0] @ returns[i, :2])
    return None if values[0] > 0.06 * values[1] else [*n, values[0] / values[1] / (len(points) - 2)]


@pytest.mark.parametrize("noise_m", [0.004, 0.02])
def test_a_normal_is_that_of_the_line_through_near_neighbours_or_else_through_more(noise_m):
    bearings, rng = Bearings(-0.4, 0.03, 30, False, 2.0, 1), np.random.default_rng(1)
    angles, normal = -0.4 + 0.03 * np.arange(30), 0.35
    ranges = 1.3 / np.cos(angles - normal) + noise_m * rng.standard_normal(30)
    ranges[20:] += 0.5  # another surface
    returns = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), ranges]).astype(np.float32)
    returns[9] = 0.0
    found, counts = np.ones((30, 3), np.float32), {"near": 0, "far": 0, "none": 0}
    fit_normals(returns, bearings, found)
    for i in (*range(9), *range(10, 30)):
        low, high = next(piece for piece in ((0, 9), (10, 20), (20, 30)) if piece[0] <= i < piece[1])
        near, far = (plain_normal(returns, i, low, high, reach_m) for reach_m in (0.12, 0.24))
        assert found[i] == pytest.approx(near or far or [0.0, 0.0, 0.0], rel=2e-3, abs=1e-5), i
        counts["near" if near else "far" if far else "none"] += 1
    assert not found[9].any() and counts["near"] > 3 and counts["far"] > (0 if noise_m < 0.01 else 4)


def test_the_covariance_of_a_link_is_that_of_its_sums_by_hand():
    rng = np.random.default_rng(6)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    hessian, spread = (axes * [90.0, 41.0, 4.0]) @ axes.T, (axes * [6.0, 1.0, 2.0]) @ axes.T
    sums = np.zeros((2, SUMS))
    sums[:, HESSIAN:GRADIENT], sums[:, SPREAD:] = hessian[np.triu_indices(3)], spread[np.triu_indices(3)]
    sums[:, WEIGHT], sums[:, SQUARES] = 80.0, (80.0 * 5e-4, 80.0 * 1e-4)
    found = covariances(sums, np.array([5.0, 1.0]), 0.01)
    for cov, share, variance in zip(found, (5.0, 2.0), (5e-4, 2e-4), strict=True):
        # Of 42, 20 and 1 returns' worth three are left out; the laser's own noise of two returns is 2e-4.
        spreads = [variance * share / (2.0 * 39.0), variance * share / (2.0 * 17.0), 1e6]
        floor = 0.01 * (variance - 2e-4) + 9e-8
        assert cov == pytest.approx((axes * spreads) @ axes.T + floor * np.diag([1.0, 1.0, 1.0 / 9.0]), abs=1e-8)


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
@pytest.mark.parametrize("travel", [0.0, 0.43, 1.9])
def test_a_step_is_as_certain_as_scans_that_drift_and_wheels_make_it(rank: int, travel: float) -> None:
    """By inverses of whole matrices, for scans that see nothing, one wall, two parallel ones and a room."""
    rng = np.random.default_rng(10 * rank + 3)
    seen, of_wheels = 30.0 * rng.normal(size=(3, rank)), rng.normal(size=(3, 3))
    told, wheels = seen @ seen.T, 90.0 * of_wheels @ of_wheels.T + np.diag([3.0, 5.0, 7.0])
    drift = travel * np.diag([_DRIFT_M, _DRIFT_M, _DRIFT_RAD]) ** 2
    cov = np.linalg.inv(told @ np.linalg.inv(np.eye(3) + drift @ told) + wheels)
    values, axes = np.linalg.eigh(cov[:2, :2])
    share = float(axes[:, 1] @ wheels[:2, :2] @ axes[:, 1]) * values[1]
    assert _step_variances(told, wheels, travel) == pytest.approx((values[1], cov[2, 2], share), rel=1e-9)
