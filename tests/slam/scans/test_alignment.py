"""Normals, point-to-line alignment of two scans, its covariance, and the see-through test."""

import math
from collections import Counter

import numpy as np
import pytest
from rooms import CORRIDOR, HALF, ROOM, ROUND, scan_at, stored
from scipy.stats import chi2

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.slam.scans.alignment import (
    GRADIENT,
    HESSIAN,
    HITS,
    SQUARES,
    SUMS,
    WEIGHT,
    Loss,
    add_one_way,
    partners_of,
)
from sixthsense.slam.scans.links import NEAR_GATE_M, align_pairs, covariances, private_covariance, reported
from sixthsense.slam.scans.returns import bearings_at, direction
from sixthsense.slam.scans.visibility import compare_views

A, B = Pose(-0.4, 0.3, 0.2), Pose(-0.15, 0.4, 0.45)
LASERS = pytest.mark.parametrize("laser", [ROUND, HALF], ids=["full circle", "half circle"])


def pair(laser, rng=None, a=A, b=B, walls=ROOM):
    return stored(scan_at(a, walls, laser, rng=rng), scan_at(b, walls, laser, rng=rng)).returns, (
        a.inverse() @ b
    ).array()


def reference(returns, target, source, pose, loss):
    """The sums of `add_one_way`, with the partner sought among all returns of the target."""
    points, normals = returns.points.astype(float), returns.normals.astype(float)
    rows, seen = [], points[target, :, 2] > 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(0, points.shape[1], bearings_at(returns, source).stride):
        if points[source, k, 2] == 0:
            continue
        arm = np.array([[c, -s], [s, c]]) @ points[source, k, :2]
        gap = np.where(seen, np.linalg.norm(pose[:2] + arm - points[target, :, :2], axis=1), np.inf)
        q = gap.argmin()
        n = normals[target, q, :2]
        turned = np.array([[c, -s], [s, c]]) @ normals[source, k, :2]
        if gap[q] >= loss.gate_m or not n.any() or (turned.any() and turned @ n < 0.7):
            continue
        r = n @ (pose[:2] + arm - points[target, q, :2])
        rows.append((q, r, np.array([*n, n @ [-arm[1], arm[0]]])))
    sums, shared = np.zeros(SUMS), Counter(q for q, _, _ in rows)
    for q, r, row in rows:
        pairs = 2 / (1 + shared[q])
        w = pairs / (1 + (r / loss.scale_m) ** 2)
        sums[HESSIAN:GRADIENT] += w * np.outer(row, row)[np.triu_indices(3)]
        sums[GRADIENT:WEIGHT] += w * row * r
        sums[[WEIGHT, HITS, SQUARES]] += w, pairs, w * r * r
    return sums


@LASERS
def test_the_kernel_agrees_with_its_reference(laser):
    returns, true = pair(laser, np.random.default_rng(1))
    loss, pose = Loss(0.1, 0.05), true + np.array([0.02, -0.01, 0.01])
    sums = np.zeros(SUMS)
    add_one_way(returns, 0, 1, pose, loss, sums)
    expected = reference(returns, 0, 1, pose, loss)
    assert sums[HITS] > 80
    assert np.allclose(sums[:12], expected[:12], rtol=0.05, atol=0.05 * sums[WEIGHT] ** 0.5)


def test_returns_that_share_a_partner_are_worth_two_pairs_at_most():
    near, far = Pose(6.0, 0.0, np.pi), Pose(0.0, 0.0)
    returns, relative = pair(HALF, a=far, b=near, walls=CORRIDOR)
    partners, shared = partners_of(returns, 0, 1, relative, NEAR_GATE_M)
    sums = np.zeros(SUMS)
    add_one_way(returns, 0, 1, relative, Loss(NEAR_GATE_M, 0.05), sums)
    assert shared.max() > 10
    assert shared.sum() == np.count_nonzero(partners >= 0)
    assert sums[HITS] == pytest.approx((2 * shared / (1 + shared)).sum())
    assert sums[HITS] < 2 * np.count_nonzero(shared) < 0.5 * shared.sum()


def test_a_direction_is_that_of_atan2_to_a_thousandth_of_a_beam():
    angles = np.linspace(-math.pi, math.pi, 10_001)
    found = [direction(2.5 * math.cos(a), 2.5 * math.sin(a)) for a in angles]
    assert np.abs(wrap_angle(np.array(found) - angles)).max() < 1.2e-5
    assert direction(0.0, 0.0) == 0.0


def test_a_full_circle_has_normals_where_it_begins_and_ends():
    returns = stored(scan_at(Pose(3.0, 0.5, 0.0), laser=ROUND)).returns  # the first beam looks at the far wall
    turned = stored(scan_at(Pose(3.0, 0.5, math.pi), laser=ROUND)).returns
    for one in (returns, turned):
        assert (np.abs(np.hypot(*one.normals[0, :, :2].T) - 1.0) < 1e-3).mean() > 0.9
    assert np.allclose(np.abs(returns.normals[0, [0, 1, -1], 0]), 1.0, atol=1e-3)


def link_covariance(found, sigma_m=0.01):
    return covariances(found.sums, np.array([2.0]), sigma_m)[0]


def covariance_of_truth(found, returns):
    """(3, 3) of an aligned pair's error: of the link between apparent poses, and the private errors of both scans."""
    link, own = link_covariance(found), [private_covariance(returns, k, 0.01) for k in (0, 1)]
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
        if not found.agree(0.6, 1.0)[0]:
            continue
        off = found.poses[0] - true
        off[2] = wrap_angle(float(off[2]))
        squared.append(off @ np.linalg.solve(covariance_of_truth(found, returns), off))
    assert len(squared) > 40
    assert np.sum(squared) < chi2.ppf(0.999, 3 * len(squared))  # not overconfident
    assert np.mean(squared) > 0.3  # nor worthless


def test_along_a_corridor_the_covariance_claims_nothing():
    rng = np.random.default_rng(4)
    returns, true = pair(HALF, rng, Pose(0.0, 0.2, 0.1), Pose(0.5, 0.25, 0.05), CORRIDOR)
    found = align_pairs(returns, np.array([0]), np.array([1]), true[None] + [0.02, 0.01, 0.01], NEAR_GATE_M)
    values, axes = np.linalg.eigh(link_covariance(found)[:2, :2])
    assert np.sqrt(values[1]) > 0.5 and np.sqrt(values[0]) < 0.02
    assert abs(axes[:, 1] @ [math.cos(0.1), -math.sin(0.1)]) > 0.999


def test_a_scan_says_nothing_of_a_private_error_along_a_corridor():
    returns, _ = pair(HALF, np.random.default_rng(5), Pose(), Pose(0.5, 0.0, 0.0), CORRIDOR)
    own = private_covariance(returns, 0, 0.01)
    values, axes = np.linalg.eigh(own[:2, :2])
    assert values[0] == pytest.approx(0.0, abs=1e-12) and abs(axes[0, 0]) > 0.999 and 0.0 < own[1, 1] < 0.005**2


def test_private_errors_are_those_of_the_laser_and_vanish_with_its_noise():
    returns, _ = pair(ROUND, np.random.default_rng(5))
    two, one, none = (private_covariance(returns, 0, sigma) for sigma in (0.02, 0.01, 0.0))
    assert np.allclose(two, 4.0 * one) and np.linalg.eigvalsh(one)[0] > 0.0 and not none.any()


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
    found = align_pairs(store.returns, *ends, np.zeros((2, 3)), NEAR_GATE_M)
    assert found.agree(0.8, 1.0).tolist() == [False, True]


def test_views_are_compared_beam_by_beam():
    store = stored(scan_at(Pose(), ROOM[:4]), scan_at(Pose(), 0.5 * ROOM[:4]))
    hits, through, count = compare_views(store.returns, 0, 1, np.zeros(3))
    assert through == count and hits == 0  # the small room stands in the view of the large one
    hits, through, count = compare_views(store.returns, 1, 0, np.zeros(3))
    assert through == hits == 0  # the large room is hidden by the small one
