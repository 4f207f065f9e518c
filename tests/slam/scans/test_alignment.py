"""Normals, point-to-line alignment of scans, its covariance, and the agreement of two scans."""

import math

import numpy as np
import pytest
from rooms import CORRIDOR, HALF, ROOM, ROUND, scan_at, stored
from scipy.stats import chi2

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.returns import Bearings, normals_of
from sixthsense.core.se2 import inverse, triple
from sixthsense.slam.scans.agreement import agreement, contradicted
from sixthsense.slam.scans.alignment import Prior, Sums, Views, add_all, align, no_sums, partners_of
from sixthsense.slam.scans.links import NEAR_GATE_M, align_pairs, covariances, private_covariance, reported
from sixthsense.slam.scans.returns import bearings_at

A, B = Pose(-0.4, 0.3, 0.2), Pose(-0.15, 0.4, 0.45)
LASERS = pytest.mark.parametrize("laser", [ROUND, HALF], ids=["full circle", "half circle"])
POSES = [A, Pose(-0.7, -0.1, -0.3), B]
AT = np.array([[0.9, -1.2, 2.1], (Pose(0.9, -1.2, 2.1) @ A.inverse() @ POSES[1]).array()])
"""poses of the first two, in a frame of their own"""
SOUGHT = Pose(*AT[0]) @ A.inverse() @ B @ Pose(0.02, -0.015, 0.012)


def pair(laser, rng=None, a=A, b=B, walls=ROOM):
    return stored(scan_at(a, walls, laser, rng=rng), scan_at(b, walls, laser, rng=rng)).returns, (
        a.inverse() @ b
    ).array()


def views(laser):
    rng = np.random.default_rng(4)
    return Views(stored(*(scan_at(pose, ROOM, laser, rng=rng) for pose in POSES)).returns, 2, np.arange(2), AT, 1.0)


def of_one(sums):
    return Sums(sums.hessian[0], sums.feigned[0], sums.gradient[0], sums.partners)


def plain_sums(seen, pose, gate_m, both):
    """The sums of `add_all` with the same partners: of each residual's value and derivatives by finite differences."""
    returns, sums = seen.returns, of_one(no_sums(1))
    points, normals = returns.points.astype(float), returns.normals.astype(float)
    for target, at in zip(seen.targets, seen.at, strict=True):
        relative = (Pose(*at).inverse() @ Pose(*pose)).array()
        ways = [(target, seen.source, relative)]
        if both:
            ways.append((seen.source, target, Pose(*relative).inverse().array()))
        for onto, moved, way in ways:
            partners, shared = partners_of(returns, onto, moved, way, gate_m)
            for i in np.flatnonzero(partners >= 0):
                q, point = partners[i], points[moved, i * bearings_at(returns, moved).stride, :2]
                n = normals[onto, q, :2]

                def off(x, n, onto=onto, point=point, q=q, at=at):
                    T = Pose(*at).inverse() @ Pose(*x)
                    return n @ ((T if onto != 2 else T.inverse()) @ point - points[onto, q, :2])

                rows = [[(off(pose + h, line) - off(pose - h, line)) / 2e-6 for h in 1e-6 * np.eye(3)]
                        for line in (n, np.array([-n[1], n[0]]))]  # fmt: skip
                row, quarter = np.array(rows)
                r, pairs = off(pose, n), 2.0 / (1.0 + shared[q])
                weight = pairs / (1.0 + (r / 0.05) ** 2)
                sums.hessian[:] += weight * np.outer(row, row)
                sums.feigned[:] += weight * normals[onto, q, 2] * np.outer(quarter, quarter)
                sums.gradient[:] += weight * row * r
                sums.partners[:] += pairs
    return sums


@LASERS
@pytest.mark.parametrize("both", [False, True])
def test_sums_over_several_scans_are_those_of_their_residuals(laser, both):
    seen, sums = views(laser), of_one(no_sums(1))
    add_all(seen, SOUGHT.array(), 0.2, both, sums)
    expected = plain_sums(seen, SOUGHT.array(), 0.2, both)
    assert sums.partners[0] > 150
    for found, plain in zip(sums, expected, strict=True):
        assert found == pytest.approx(plain, rel=1e-4, abs=1e-4 * sums.partners[0])


@LASERS
@pytest.mark.parametrize("slip_sigmas", [math.inf, 2.0])
def test_an_aligned_pose_balances_the_scans_and_what_was_known_before(laser, slip_sigmas):
    seen, sums = views(laser), of_one(no_sums(1))
    root = np.array([[300.0, 40.0, 9.0], [0.0, 200.0, 30.0], [0.0, 0.0, 400.0]])
    turn = np.array([0.0, 0.0, 2.0 * math.pi])
    prior = Prior((SOUGHT @ Pose(0.01, 0.02, 0.01)).array() + turn, root.T @ root, slip_sigmas)
    pose = SOUGHT.array()
    align(seen, prior, 0.3, True, pose, sums)
    add_all(seen, pose, 0.12, True, sums)
    off = pose - prior.pose + turn
    pull = prior.information @ off / (1.0 + off @ prior.information @ off / slip_sigmas**2)
    of_scans = sums.gradient / (0.03**2 * 2)  # two scans that see the same surfaces count once
    assert np.linalg.norm(pull) > 100.0
    assert np.linalg.norm(of_scans + pull) < 0.05 * np.linalg.norm(pull)


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
    found, counts = normals_of(returns, bearings), {"near": 0, "far": 0, "none": 0}
    for i in (*range(9), *range(10, 30)):
        low, high = next(piece for piece in ((0, 9), (10, 20), (20, 30)) if piece[0] <= i < piece[1])
        near, far = (plain_normal(returns, i, low, high, reach_m) for reach_m in (0.12, 0.24))
        assert found[i] == pytest.approx(near or far or [0.0, 0.0, 0.0], rel=2e-3, abs=1e-5), i
        counts["near" if near else "far" if far else "none"] += 1
    assert not found[9].any() and counts["near"] > 3 and counts["far"] > (0 if noise_m < 0.01 else 4)


def covariance_of_truth(found, returns):
    """(3, 3) of an aligned pair's error: of the link between apparent poses, and the private errors of both scans."""
    (link,), own = covariances(found.hessians, 0.01), [private_covariance(returns, k, 0.01) for k in (0, 1)]
    return reported(link, found.poses[0], own[1], own[0], np.zeros(3))


@LASERS
def test_alignment_finds_the_motion_within_its_covariance(laser):
    squared, rng = [], np.random.default_rng(3)
    for _ in range(60):
        a = Pose(rng.uniform(-1, 0.5), rng.uniform(-1, 1), rng.uniform(-3, 3))
        b = a @ Pose(*rng.normal(0, [0.2, 0.2, 0.2]))
        returns, true = pair(laser, rng, a, b)
        start = true + rng.normal(0, [0.03, 0.03, 0.02])
        found = align_pairs(returns, np.array([0]), np.array([1]), start[None], NEAR_GATE_M)
        if not found.agree(0.8)[0]:
            continue
        off = found.poses[0] - true
        off[2] = wrap_angle(float(off[2]))
        squared.append(off @ np.linalg.solve(covariance_of_truth(found, returns), off))
    assert len(squared) > 40
    assert np.sum(squared) < chi2.ppf(0.999, 3 * len(squared))  # not overconfident
    assert np.mean(squared) > 0.3  # nor worthless


def test_the_covariance_of_a_link_is_that_of_its_hessian_by_hand():
    axes = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    (found,) = covariances(((axes * [84.0, 40.0, 2.0]) @ axes.T)[None], 0.01)
    # Of 42, 20 and 1 returns three are left out; the noise of two returns is 2e-4.
    assert found == pytest.approx((axes * [2e-4 / 39.0, 2e-4 / 17.0, 1e6]) @ axes.T, abs=1e-8)


def test_a_scan_has_no_private_error_along_a_corridor():
    returns, _ = pair(HALF, np.random.default_rng(5), Pose(), Pose(0.5, 0.0, 0.0), CORRIDOR)
    own = private_covariance(returns, 0, 0.01)
    values, axes = np.linalg.eigh(own[:2, :2])
    assert values[0] == pytest.approx(0.0, abs=1e-12) and abs(axes[0, 0]) > 0.999 and 0.0 < own[1, 1] < 0.005**2


@LASERS
def test_private_errors_are_what_two_scans_of_one_view_are_off_by(laser):
    squared, rng = [], np.random.default_rng(3)
    for _ in range(100):
        a = Pose(rng.uniform(-1, 0.5), rng.uniform(-1, 1), rng.uniform(-3, 3))
        returns, true = pair(laser, rng, a, a @ Pose(*rng.normal(0, [0.05, 0.05, 0.05])))
        found = align_pairs(returns, np.array([0]), np.array([1]), true[None], NEAR_GATE_M)
        first, second = (private_covariance(returns, k, 0.01) for k in (0, 1))
        off = found.poses[0] - true
        cov = reported(np.zeros((3, 3)), found.poses[0], second, first, np.zeros(3))
        squared.append(off @ np.linalg.solve(cov, off))
    # A few returns at edges and on other lines are the rest.
    assert chi2.ppf(0.001, 300) < np.sum(squared) < 1.5 * chi2.ppf(0.999, 300)


def test_the_first_scans_error_turns_all_that_follows():
    first = np.diag([0.0, 0.0, 0.01**2])
    far = reported(np.zeros((3, 3)), np.array([0.0, 10.0, 1.0]), np.zeros((3, 3)), first, np.zeros(3))
    assert math.sqrt(far[0, 0]) == pytest.approx(0.1) and far[1, 1] == pytest.approx(0.0, abs=1e-12)


def test_a_scan_that_looks_through_a_wall_is_rejected():
    """Two rooms of one width, the second deeper: its scan fits the side walls of the first."""
    deep = np.array([[[-4, -3], [9, -3]], [[9, -3], [9, 3]], [[9, 3], [-4, 3]], [[-4, 3], [-4, -3]]], dtype=float)
    store = stored(*(scan_at(Pose(2.0, y, 0.0), walls) for y, walls in ((0.0, ROOM[:4]), (0.0, deep), (0.1, ROOM[:4]))))
    ends = np.array([0, 0]), np.array([1, 2])
    assert align_pairs(store.returns, *ends, np.zeros((2, 3)), NEAR_GATE_M).agree(1.0).tolist() == [False, True]


def test_a_right_pose_is_not_contradicted_a_wrong_one_is_and_a_few_returns_are_no_evidence():
    returns, true = pair(ROUND, np.random.default_rng(2))
    right, wrong = (agreement(returns, 0, 1, (Pose(*true) @ off).triple()) for off in (Pose(), Pose(0.8, 0.0, 0.5)))
    assert contradicted(right.hits, right.through) < 0.05 < 0.3 < contradicted(wrong.hits, wrong.through)
    assert contradicted(3.0, 9.0) == 0.0 and contradicted(30.0, 90.0) == 0.75


def test_a_room_that_hides_another_one_is_seen_through_from_there_alone():
    store = stored(scan_at(Pose(), ROOM[:4]), scan_at(Pose(), 0.5 * ROOM[:4]))
    small = agreement(store.returns, 0, 1, inverse(triple(np.zeros(3))))
    assert small.through == small.total and small.hits == 0  # the small room stands in the view of the large one
    large = agreement(store.returns, 1, 0, (0.0, 0.0, 0.0))
    assert large.through == large.hits == 0  # the large room is hidden by the small one
