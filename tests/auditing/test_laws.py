"""Errors and covariances of general poses, tilted, turned and correlated, against matrices, scipy and differences."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

import sixthsense as ss

N = 7
SEEDS = st.integers(0, 2**31)
SPACES = st.sampled_from([2, 3])
FRAMES = st.sampled_from(["world", "body"])
few = settings(max_examples=12, deadline=None)


@dataclasses.dataclass
class Drawn:
    """Poses as matrices, the truth and the estimate, and covariances; nothing in them is zero."""

    stamps: np.ndarray
    truth: np.ndarray
    estimate: np.ndarray
    covs: np.ndarray

    def audit(self, **options):
        return ss.audit((self.stamps, self.estimate, self.covs), (self.stamps, self.truth), **options)


def exp(vector):
    if len(vector) == 3:
        return Rotation.from_rotvec(vector).as_matrix()
    c, s = math.cos(vector[0]), math.sin(vector[0])
    return np.array([[c, -s], [s, c]])


def log(turn):
    return Rotation.from_matrix(turn).as_rotvec() if len(turn) == 3 else [math.atan2(turn[1, 0], turn[0, 0])]


def motion(turn, place):
    out = np.eye(len(turn) + 1)
    out[:-1, :-1], out[:-1, -1] = turn, place
    return out


def drawn(seed, n, noise=0.1):
    rng = np.random.default_rng(seed)
    turns, dof = (1, 3) if n == 2 else (3, 6)
    truth = np.array([motion(exp(rng.uniform(-2.0, 2.0, turns)), rng.uniform(-9.0, 9.0, n)) for _ in range(N)])
    estimate = np.array([motion(exp(rng.normal(0.0, noise, turns)) @ t[:n, :n], t[:n, n] + rng.normal(0.0, noise, n))
                         for t in truth])  # fmt: skip
    root = 0.2 * (np.eye(dof) + rng.uniform(-0.5, 0.5, (N, dof, dof)))
    covs = root @ root.transpose(0, 2, 1) + 0.05**2 * np.eye(dof)  # a product alone may be singular, and is left out
    return Drawn(np.cumsum(rng.uniform(0.2, 0.4, N)) + 3.0, truth, estimate, covs)


def axes(turn):
    """The rotation of an error, translation first, by blocks."""
    n = len(turn)
    out = np.eye(3 if n == 2 else 6)
    out[:n, :n] = turn
    if n == 3:
        out[3:, 3:] = turn
    return out


def error(estimate, truth):
    n = len(truth) - 1
    return np.append(estimate[:n, n] - truth[:n, n], log(estimate[:n, :n] @ truth[:n, :n].T))


def squared(error, cov):
    return float(error @ np.linalg.inv(cov) @ error)


@few
@given(SEEDS, SPACES, FRAMES)
def test_errors_covariances_and_ratios_are_those_of_matrices_in_either_frame(seed, n, frame):
    one = drawn(seed, n)
    found = one.audit(frame=frame)
    run = found.runs[0]
    assert run.stamps_ns.tolist() == [round(1e9 * stamp) for stamp in one.stamps]
    squares, ratios = [], []
    for k, (estimate, truth, cov) in enumerate(zip(one.estimate, one.truth, one.covs, strict=True)):
        turn = axes(estimate[:n, :n])
        in_world = turn @ cov @ turn.T if frame == "body" else cov
        np.testing.assert_allclose(run.error[k], error(estimate, truth), atol=1e-9)
        np.testing.assert_allclose(run.cov[k], in_world, atol=1e-9)
        squares.append(squared(error(estimate, truth), in_world))
        own = turn.T @ error(estimate, truth) if frame == "body" else error(estimate, truth)
        ratios.append(own**2 / np.diag(cov))
    assert run.nees == pytest.approx(squares) and found.findings.pose.nees == pytest.approx(np.mean(squares))
    told, dof = found.findings, 3 if n == 2 else 6
    share = np.mean(np.array(squares) <= chi2.ppf(0.95, dof))
    assert told.coverage[0.95] == share and told.factor == told.pose.nees / dof
    assert told.pose.band == pytest.approx(chi2.ppf((0.025, 0.975), dof * told.pose.samples) / told.pose.samples)
    assert [one.factor for one in told.axes.values()] == pytest.approx(np.mean(ratios, axis=0))


@few
@given(SEEDS, SPACES, FRAMES)
def test_the_nees_does_not_depend_on_the_frame_of_the_world(seed, n, frame):
    one, rng = drawn(seed, n), np.random.default_rng(seed + 1)
    by = motion(exp(rng.uniform(-2.0, 2.0, 1 if n == 2 else 3)), rng.uniform(-5.0, 5.0, n))
    turn = axes(by[:n, :n])
    covs = turn @ one.covs @ turn.T if frame == "world" else one.covs
    other = Drawn(one.stamps, by @ one.truth, by @ one.estimate, covs)
    for align in ("none", "all"):
        expected = one.audit(frame=frame, align=align).runs[0].nees
        np.testing.assert_allclose(other.audit(frame=frame, align=align).runs[0].nees, expected, rtol=1e-4)


@few
@given(SEEDS, SPACES, FRAMES)
def test_an_alignment_by_all_poses_has_the_least_sum_of_nees(seed, n, frame):
    """No motion nearby has a smaller one; the covariances turn with the motion."""
    one, dof = drawn(seed, n, 0.02), 3 if n == 2 else 6
    rng = np.random.default_rng(seed)
    away = motion(exp(rng.uniform(-2.0, 2.0, dof - n)), rng.uniform(-5.0, 5.0, n))
    one.estimate = np.linalg.inv(away) @ one.estimate
    turn = axes(away[:n, :n])
    one.covs = turn.T @ one.covs @ turn if frame == "world" else one.covs
    run = one.audit(frame=frame, align="all").runs[0]
    by = run.turns[0].as_matrix()[:n, :n] @ one.estimate[0, :n, :n].T
    found = motion(by, run.error[0, :n] + one.truth[0, :n, n] - by @ one.estimate[0, :n, n])

    def cost(motion_, first):
        total = 0.0
        for estimate, truth, cov in zip(motion_ @ one.estimate, one.truth, one.covs, strict=True):
            turn = axes(estimate[:n, :n] if frame == "body" else first[:n, :n])
            total += squared(error(estimate, truth), turn @ cov @ turn.T)
        return total

    least = cost(found, found)
    assert run.nees.sum() == pytest.approx(least)
    centre = (found @ one.estimate)[:, :n, n].mean(axis=0)
    for step in np.concatenate([np.eye(dof), -np.eye(dof)]) * 0.02:
        by = motion(exp(step[n:]), centre + step[:n]) @ motion(np.eye(n), -centre)
        assert cost(by @ found, found) > least - 1e-9


@few
@given(SEEDS, SPACES)
def test_the_forms_of_poses_and_the_orders_of_covariances_are_the_same_audit(seed, n):
    one = drawn(seed, n)
    expected = one.audit().runs[0]
    places, turns = one.estimate[:, :n, n], one.estimate[:, :n, :n]
    scale = np.linspace(0.4, 2.3, N)[:, None]  # a quaternion need not have the norm 1
    last = scale * Rotation.from_matrix(turns).as_quat() if n == 3 else np.array([log(turn) for turn in turns])
    half = -3 if n == 3 else -2
    rolled = np.roll(one.covs, (half, half), axis=(1, 2))
    form = (one.stamps, np.column_stack([places, last]), rolled)
    found = ss.audit(form, (one.stamps, one.truth), order="rotation").runs[0]
    np.testing.assert_allclose(found.nees, expected.nees)
    np.testing.assert_allclose(found.cov, expected.cov)


@few
@given(SEEDS, st.sampled_from(["3 x 3", "no variances of z", "planar truth", "level"]))
def test_what_is_audited_in_the_plane_is_x_y_and_yaw_of_tilted_poses(seed, why):
    one = drawn(seed, 3)
    poses, covs = one.estimate.copy(), one.covs.copy()
    yaw = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX")[:, 0]
    truth = np.column_stack([one.truth[:, :2, 3], Rotation.from_matrix(one.truth[:, :3, :3]).as_euler("ZYX")[:, 0]])
    plane = covs[:, (0, 1, 5)][:, :, (0, 1, 5)]
    given_truth = one.truth
    if why == "3 x 3":
        covs = plane
    elif why == "no variances of z":
        covs[:, (2, 3, 4)], covs[:, :, (2, 3, 4)] = 0.0, 0.0
    elif why == "planar truth":
        given_truth = truth
    else:
        poses[:, :3, :3], poses[:, 2, 3] = Rotation.from_euler("z", yaw[:, None]).as_matrix(), 0.37
    found = ss.audit((one.stamps, poses, covs), (one.stamps, given_truth))
    off = np.column_stack([poses[:, :2, 3], yaw]) - truth
    off[:, 2] = [math.remainder(value, 2.0 * math.pi) for value in off[:, 2]]
    np.testing.assert_allclose(found.runs[0].error, off, atol=1e-9)
    assert found.runs[0].nees == pytest.approx([squared(*each) for each in zip(off, plane, strict=True)])
    in_space = [one.estimate.copy(), one.estimate.copy()]
    in_space[0][:, 2, 3] = 0.37  # tilted at one height; level at several
    in_space[1][:, :3, :3] = Rotation.from_euler("z", yaw[:, None]).as_matrix()
    covs = one.covs.copy()
    covs[0, 2:5], covs[0, :, 2:5] = 0.0, 0.0  # of a single pose
    for poses in in_space:
        assert ss.audit((one.stamps, poses, covs), (one.stamps, one.truth)).findings.pose.dof == 6


@few
@given(SEEDS, SPACES)
def test_the_truth_between_two_poses_is_on_the_line_and_the_great_circle_between_them(seed, n):
    one, rng = drawn(seed, n), np.random.default_rng(seed)
    gaps = np.diff(one.stamps)
    at = np.sort(one.stamps[:-1] + rng.uniform(0.1, 0.9, N - 1) * gaps)
    places = np.column_stack([np.interp(at, one.stamps, column) for column in one.truth[:, :n, n].T])
    spatial = np.tile(np.eye(3), (N, 1, 1))
    spatial[:, :n, :n] = one.truth[:, :n, :n]
    turns = Slerp(one.stamps, Rotation.from_matrix(spatial))(at).as_matrix()[:, :n, :n]
    estimate = np.array(
        [motion(exp(np.full(1 if n == 2 else 3, 0.1)) @ t, p - 0.3) for t, p in zip(turns, places, strict=True)]
    )
    found = ss.audit((at, estimate, one.covs[:-1]), (one.stamps, one.truth)).runs[0]
    expected = [error(e, motion(t, p)) for e, t, p in zip(estimate, turns, places, strict=True)]
    np.testing.assert_allclose(found.error, expected, atol=1e-6)


@few
@given(SEEDS, SPACES)
def test_the_position_errors_of_a_trajectory_before_and_after_an_alignment_are_those_of_scipy(seed, n):
    one, rng = drawn(seed, n), np.random.default_rng(seed + 2)
    one.estimate = motion(exp(rng.uniform(-2.0, 2.0, 1 if n == 2 else 3)), rng.uniform(-5.0, 5.0, n)) @ one.estimate
    found = one.audit(align="all").trajectory
    truth, places = (np.pad(poses[:, :n, n], ((0, 0), (0, 3 - n))) for poses in (one.truth, one.estimate))
    assert found.ate_m == pytest.approx(np.sqrt(np.mean(np.sum((places - truth) ** 2, axis=1))))
    _, distance = Rotation.align_vectors(truth - truth.mean(axis=0), places - places.mean(axis=0))
    assert found.aligned_ate_m == pytest.approx(distance / math.sqrt(N), abs=1e-6)
