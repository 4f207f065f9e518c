"""Errors of known covariances: what is told of a system beside a truth, and of two without one, and how often."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.auditing.statistics import power
from sixthsense.config.errors import InputError

COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4
OTHER = np.array([[20.0, -6.0, 1.0], [-6.0, 40.0, 0.5], [1.0, 0.5, 2.0]]) * 1e-4


def errors(rng, count, rho=0.0, cov=COV):
    """AR(1) errors of a covariance."""
    white = rng.standard_normal((count, 3))
    white[1:] *= math.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], white, axis=0) @ np.linalg.cholesky(cov).T


def truth(count):
    stamps = 300.0 / count * np.arange(count) + 5.0
    heading = 0.05 * stamps + 0.3
    return stamps, np.column_stack([8.0 * np.sin(heading), 2.0 - 8.0 * np.cos(heading), heading])


def system(count, error, cov=COV):
    stamps, poses = truth(count)
    return stamps, poses + error, np.broadcast_to(cov, (count, 3, 3))


N = 4000
STAMPS, TRUTH = truth(N)


def audited(error, cov=COV, **options):
    return ss.audit(system(N, error, cov), (STAMPS, TRUTH), **options)


@pytest.mark.parametrize(("scale", "outcome"), [(0.5, "overconfident"), (1.0, "consistent"), (2.0, "cautious")])
@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_the_verdict_and_the_factor_are_right_for_white_and_for_correlated_errors(rho, scale, outcome):
    found = audited(errors(np.random.default_rng(1), N, rho), scale * COV)
    assert found.outcome == outcome and found.verdict.startswith(outcome)
    low, high = found.findings.pose.interval
    assert low < 1.0 / scale < high
    assert found.findings.pose.samples < (1.05 * N if rho == 0.0 else 0.1 * N)


@pytest.mark.parametrize(("true", "read"), [("body", "world"), ("world", "body")])
def test_the_wrong_frame_is_noticed_since_the_nees_depends_on_the_heading(true, read):
    c, s = np.cos(TRUTH[:, 2]), np.sin(TRUTH[:, 2])
    error = errors(np.random.default_rng(5), N)
    if true == "body":
        error = np.column_stack([c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1], error[:, 2]])
    assert f"may have the axes of the {true}" in repr(audited(error, frame=read))
    assert "depends on the heading" not in repr(audited(error, frame=true))
    isotropic = np.diag([0.01, 0.01, 1e-4])
    error = errors(np.random.default_rng(0), N, cov=isotropic)
    assert "depends on the heading" not in repr(audited(error, isotropic, frame=read))


def test_the_degrees_of_freedom_of_an_alignment_are_taken_off():
    """Of short runs with white errors: without it the mean NEES of 40 poses would be 2.93."""
    runs = [system(40, errors(np.random.default_rng(k), 40)) for k in range(150)]
    found = ss.audit(runs, [truth(40)] * 150, align="all")
    plain = float(np.mean(np.concatenate([run.nees for run in found.runs])))
    assert plain == pytest.approx(3.0 * (1.0 - 1.0 / 40), abs=0.07)
    assert found.findings.pose.nees == pytest.approx(plain / (1.0 - found.findings.removed)) != plain


def moved(system, motion):
    """The same system in a frame of its own, `motion` from it; covariances turn with it."""
    stamps, poses, covs = system
    T, turn = ss.Pose(*motion), np.eye(3)
    turn[:2, :2] = [[math.cos(motion[2]), -math.sin(motion[2])], [math.sin(motion[2]), math.cos(motion[2])]]
    return stamps, np.array([(T @ ss.Pose(*pose)).array() for pose in poses]), turn @ covs @ turn.T


def pair(seed, times, count=30, rho=0.0):
    rng = np.random.default_rng(seed)
    first, second = (system(count, one) for one in (times * errors(rng, count, rho), errors(rng, count, rho)))
    return ss.audit(first, pair=moved(second, (3.0, -2.0, 0.8)))


def test_a_system_whose_errors_are_twice_its_sigmas_is_told_by_thirty_poses_of_another():
    found = [pair(seed, 2.0) for seed in range(25)]
    assert sum(one.outcome == "overconfident" for one in found) >= 24
    assert np.mean([one.pair.least for one in found]) == pytest.approx(math.sqrt(2.5 / 1.3), abs=0.12)


def test_two_honest_systems_in_frames_of_their_own_are_rarely_called_overconfident():
    assert sum(pair(seed, 1.0).outcome == "overconfident" for seed in range(40)) <= 5  # 2 expected


@pytest.mark.parametrize(("times", "samples"), [(1.0, 20), (1.5, 20), (1.4, 41), (2.0, 9)])
def test_the_power_that_is_told_is_that_of_chi_square_where_both_covariances_are_equal(times, samples):
    covs = np.broadcast_to(COV, (77, 3, 3))
    expected = float(chi2.sf(chi2.ppf(0.95, 3 * samples) / (0.5 * (times**2 + 1.0)), 3 * samples))
    assert power(2.0 * covs, covs, samples, times) == pytest.approx(expected, abs=0.03)


def test_what_one_must_be_if_the_other_is_honest_follows_from_their_shares():
    rng = np.random.default_rng(3)
    first, second = system(3000, 3.0 * errors(rng, 3000)), system(3000, errors(rng, 3000, cov=4.0 * COV), 4.0 * COV)
    found = ss.audit(first, pair=second, align="none").pair
    # (9 + 4) / 5 of the stated sum: the first one alone is 3 times, the second alone sqrt((13 - 1) / 4) times.
    assert found.if_other_honest == (pytest.approx(3.0, rel=0.06), pytest.approx(math.sqrt(3.0), rel=0.06))
    assert found.least == pytest.approx(math.sqrt(13.0 / 5.0), rel=0.05)
    assert found.if_other_honest[0] < 3.0 and found.least < math.sqrt(13.0 / 5.0)  # limits, not means


def test_errors_that_both_share_hide_and_are_told_as_less_than_allowed():
    rng = np.random.default_rng(4)
    shared = 2.0 * errors(rng, 2000)
    first, second = (system(2000, shared + 0.3 * errors(rng, 2000)) for _ in range(2))
    found = ss.audit(first, pair=second)
    assert found.outcome == "cautious" and "depend on each other" in found.verdict


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"truth": truth(30)}, "pair: found beside a truth"),
        ({"pair": [system(30, 0.0)]}, "pair: found a list of 1, allowed: one system"),
    ],
)
def test_a_pair_that_cannot_be_is_refused(given, said):
    first, second = (system(30, errors(np.random.default_rng(seed), 30)) for seed in (8, 9))
    with pytest.raises(InputError, match=said):
        ss.audit(first, **({"pair": second} | given))
