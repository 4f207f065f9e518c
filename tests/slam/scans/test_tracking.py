"""Which pose a scan is tracked at: what the wheels say against what it sees."""

import dataclasses

import numpy as np
import pytest
from rooms import scan_at, stored

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.agreement import agreement_of
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.tracking import SLIP_SIGMAS, LastScan, Usual, aligned, expected, track, tracked_at

FIRST, TRUE = Pose(-1.2, 0.7, 0.4), Pose(-0.9, 0.8, 0.6)
USUAL = Usual(0.05, 0.6)


def views_and_prior(scan: Scan, said: Pose, sigmas=(0.01, 0.01, 0.01)):
    store = stored(scan_at(FIRST), scan)
    prior = Prior(said.array(), np.diag(np.array(sigmas) ** -2.0), SLIP_SIGMAS)
    return Views(store.returns, 1, np.array([0]), FIRST.array()[None], 1.0), prior


def tracked(scan: Scan, said: Pose, usual=USUAL):
    return track(*views_and_prior(scan, said), said.array()[None], usual, False)


def test_what_is_known_before_a_scan_is_aligned_follows_from_the_odometry_and_the_mount():
    key, mount, last_since, since = Pose(1.5, -0.7, 2.1), Pose(0.3, -0.2, 0.4), Pose(0.2, 0.1, 0.3), Pose(0.5, 0.3, 0.7)
    last, root = Pose(1.9, -0.2, 2.5), np.array([[0.05, 0.0, 0.0], [0.01, 0.03, 0.0], [0.02, -0.01, 0.04]])
    cov, factors, moved = root @ root.T, np.outer((1.5, 1.5, 0.7), (1.5, 1.5, 0.7)), Pose(0.1, 0.02, 0.05)
    scan = LastScan(last.array(), last_since.triple(), moved.triple())
    found = expected(key.array(), scan, mount.triple(), since.triple(), cov, factors)

    def by_error(pose_of):  # the Jacobian of a pose by the error of the odometry, axes of its end
        rows = [pose_of(Pose(*h)).array() - pose_of(Pose(*-h)).array() for h in 1e-6 * np.eye(3)]
        return np.array(rows).T / 2e-6

    assert found.prior.pose == pytest.approx((key @ mount.inverse() @ since @ mount).array())
    own, wheels = (by_error(lambda e, T=T: T @ e @ mount) for T in (key @ mount.inverse() @ since, mount.inverse()))
    np.testing.assert_allclose(np.linalg.inv(found.prior.information), own @ (cov * factors) @ own.T, rtol=1e-5)
    np.testing.assert_allclose(found.stated, wheels @ cov @ wheels.T, rtol=1e-5)
    step = mount.inverse() @ last_since.inverse() @ since @ mount
    np.testing.assert_allclose(found.starts, [(last @ each).array() for each in (step, moved, Pose())])


@pytest.mark.parametrize("slip", [(0.3, -0.1, 0.0), (-0.35, 0.25, 0.2)])
def test_a_scan_that_fits_elsewhere_says_that_good_wheels_have_slipped(slip):
    found = tracked(scan_at(TRUE), Pose.from_array(compose(TRUE.array(), np.array(slip))))
    assert found.has_slipped and not found.is_lost
    assert np.abs(between(found.pose, TRUE.array())) == pytest.approx(np.zeros(3), abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_scan_that_fits_nowhere_does_not_move_the_robot_from_where_good_wheels_say(seed):
    true, rng = scan_at(TRUE), np.random.default_rng(seed)
    clutter = true.ranges * rng.uniform(0.3, 0.8, len(true.ranges)).astype(np.float32)
    found = tracked(dataclasses.replace(true, ranges=clutter), TRUE)
    assert found.is_lost or np.abs(between(found.pose, TRUE.array())).max() < 0.06


def test_wheels_are_believed_where_nothing_is_seen():
    true = scan_at(TRUE)
    found = tracked(dataclasses.replace(true, ranges=np.full_like(true.ranges, np.inf)), TRUE)
    assert not found.is_lost and not found.has_slipped
    assert found.pose == pytest.approx(TRUE.array(), abs=1e-9)


def test_fewer_returns_on_lines_than_usual_are_evidence_against_a_pose():
    true = scan_at(TRUE)
    uneven = true.ranges + np.resize([0.05, -0.05, 0.0], len(true.ranges)).astype(np.float32)
    views, prior = views_and_prior(dataclasses.replace(true, ranges=uneven), TRUE)

    def usually(lines):
        return tracked_at(views, prior, prior, TRUE.array(), 0.25, Usual(0.05, lines), False)

    found = usually(USUAL.lines).lines
    assert found < 0.75
    alike, fewer = usually(found), usually(0.97)
    assert fewer.lines == alike.lines and fewer.log_odds < alike.log_odds - 2.0
    shares = np.linspace(0.05, 0.95, 19)
    assert shares[np.argmax([usually(share).log_odds for share in shares])] == pytest.approx(found, abs=0.1)


@pytest.mark.parametrize("is_guess", [False, True])
def test_the_agreement_of_a_tracked_scan_is_that_at_its_pose(is_guess):
    views, prior = views_and_prior(scan_at(TRUE), TRUE @ Pose(0.04, -0.03, 0.02))
    found = tracked_at(views, prior, prior, TRUE.array(), 0.25, USUAL, is_guess)
    agreed = agreement_of(views, found.pose)
    assert found.lines == pytest.approx(agreed.lines / (agreed.hits + agreed.through), rel=1e-12)


def test_the_newest_scan_has_a_fiftieth_of_what_is_usual():
    found = tracked(scan_at(TRUE), TRUE)
    expected = 0.98 * np.array(USUAL) + 0.02 * np.array([found.contradicted, found.lines])
    np.testing.assert_allclose(found.usual(USUAL), expected)


def test_a_tracked_pose_is_as_certain_as_the_wheels_and_the_scan_together():
    views, prior = views_and_prior(scan_at(TRUE), TRUE, (0.02, 0.05, 0.03))
    found = track(views, prior, TRUE.array()[None], USUAL, False)
    scan = aligned(views, prior, TRUE.array(), 0.25).information
    assert np.allclose(found.cov, np.linalg.inv(prior.information + scan), rtol=1e-6)
    assert np.linalg.eigvalsh(scan)[0] >= 0.0
    off = found.pose - prior.pose
    assert found.off == pytest.approx(off) and found.square == pytest.approx(off @ prior.information @ off)


def test_two_scans_that_see_the_same_count_as_one():
    views, prior = views_and_prior(scan_at(TRUE), TRUE)
    firm = prior._replace(information=1e12 * np.eye(3), slip_sigmas=np.inf)
    twice = views._replace(targets=np.array([0, 0]), at=np.repeat(views.at, 2, axis=0))
    one, two = (aligned(each, firm, firm.pose, 0.25).information for each in (views, twice))
    assert one == pytest.approx(two, rel=1e-6) and np.trace(one) > 1e5


def test_returns_of_a_larger_variance_count_as_a_prior_of_more_information_makes_them():
    """The pose is that of the ratio of both alone; the information of the scan is as much less."""
    said = Pose.from_array(compose(TRUE.array(), np.array([0.03, -0.02, 0.01])))
    views, prior = views_and_prior(scan_at(TRUE), said, (0.004, 0.003, 0.002))
    firm = prior._replace(slip_sigmas=np.inf)
    less = aligned(views._replace(factor=6.5), firm, firm.pose, 0.0)
    alike = aligned(views, firm._replace(information=6.5 * firm.information), firm.pose, 0.0)
    np.testing.assert_allclose(less.pose, alike.pose, atol=1e-9)
    np.testing.assert_allclose(6.5 * less.information, alike.information, rtol=1e-9)
    assert np.hypot(*(less.pose - aligned(views, firm, firm.pose, 0.0).pose)[:2]) > 0.001
