"""Which pose a scan is tracked at: what the wheels say against what it sees."""

import dataclasses

import numpy as np
import pytest
from rooms import scan_at, stored

from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.tracking import SLIP_SIGMAS, Usual, informations_in_world, refine, search, track

FIRST, TRUE = Pose(-1.2, 0.7, 0.4), Pose(-0.9, 0.8, 0.6)
USUAL = Usual(0.05, 0.6)


def views_and_prior(scan: Scan, said: Pose, sigmas=(0.01, 0.01, 0.01)):
    store = stored(scan_at(FIRST), scan)
    prior = Prior(said.array(), np.diag(np.array(sigmas) ** -2.0), SLIP_SIGMAS)
    return Views(store.returns, 1, np.array([0]), FIRST.array()[None]), prior


def tracked(scan: Scan, said: Pose):
    views, prior = views_and_prior(scan, said)
    found = track(views, prior, said.array()[None], USUAL, False)
    if not found.is_lost:
        return found
    return max(found, search(views, prior, USUAL, False), key=lambda each: each.log_odds)


@pytest.mark.parametrize("slip", [(0.3, -0.1, 0.0), (-0.35, 0.25, 0.3)])
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


def test_nothing_is_said_against_wheels_where_nothing_is_seen():
    true = scan_at(TRUE)
    blank = dataclasses.replace(true, ranges=np.full_like(true.ranges, np.inf))
    found = tracked(blank, TRUE)
    assert not found.is_lost and not found.has_slipped
    assert found.pose == pytest.approx(TRUE.array(), abs=1e-9)


def test_a_tracked_pose_is_as_certain_as_the_wheels_and_the_scan_together():
    views, prior = views_and_prior(scan_at(TRUE), TRUE, (0.02, 0.05, 0.03))
    for is_guess in (False, True):
        found = track(views, prior, TRUE.array()[None], USUAL, is_guess)
        assert np.allclose(found.cov, np.linalg.inv(prior.information + found.information), rtol=1e-9)
        assert np.linalg.eigvalsh(found.information)[0] >= 0.0
        off = found.pose - prior.pose
        assert found.off == pytest.approx(off) and found.slip == pytest.approx(off @ prior.information @ off)


def test_informations_are_inverses_of_the_lasers_covariances_in_the_worlds_axes():
    rng, mount = np.random.default_rng(0), (0.3, -0.2, 0.7)
    keys, motions = rng.uniform(-4, 4, size=(2, 7, 3))
    factors = rng.normal(size=(7, 3, 3)) * [[0.1], [0.03], [0.01]]
    covs = factors @ factors.transpose(0, 2, 1) + 1e-5 * np.eye(3)
    for k, found in enumerate(informations_in_world(keys, motions, covs, mount)):

        def in_world(motion, key=keys[k]):
            of_laser = Pose(*mount).inverse() @ Pose(*motion) @ Pose(*mount)
            return np.append(rotation(key[2]) @ of_laser.position, of_laser.theta)

        steps = 1e-6 * np.eye(3)
        jacobian = np.column_stack([(in_world(motions[k] + h) - in_world(motions[k] - h)) / 2e-6 for h in steps])
        assert np.allclose(found, np.linalg.inv(jacobian @ covs[k] @ jacobian.T), rtol=1e-6)


def test_what_is_usual_is_learnt_from_one_scan_in_fifty():
    """A scan without a contradiction takes a fiftieth from the share of contradictions, whatever is usual of lines."""
    views, prior = views_and_prior(scan_at(TRUE), TRUE)
    few, many = (track(views, prior, TRUE.array()[None], Usual(0.11, lines), False).usual for lines in (0.3, 0.7))
    assert few.contradicted == pytest.approx(0.98 * 0.11, rel=1e-12)
    assert many.lines - few.lines == pytest.approx(0.98 * 0.4, rel=1e-12)


def test_returns_of_a_larger_variance_count_as_a_prior_of_more_information_makes_them():
    """The pose is that of the ratio of both alone; what the scan says is as much less."""
    said = Pose.from_array(compose(TRUE.array(), np.array([0.03, -0.02, 0.01])))
    views, prior = views_and_prior(scan_at(TRUE), said, (0.004, 0.003, 0.002))
    firm = prior._replace(slip_sigmas=np.inf)
    less, alike = (
        refine(views._replace(factor=6.5), firm),
        refine(views, firm._replace(information=6.5 * firm.information)),
    )
    np.testing.assert_allclose(less.pose, alike.pose, atol=1e-9)
    np.testing.assert_allclose(6.5 * less.information, alike.information, rtol=1e-9)
    assert np.hypot(*(less.pose - refine(views, firm).pose)[:2]) > 0.001
