"""Errors drawn from a known covariance: the audit finds the covariance that the estimate should have stated."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

import sixthsense as ss

N = 4000
STAMPS = 0.1 * np.arange(N)
HEADING = 0.05 * STAMPS
TRUTH = np.column_stack([8.0 * np.sin(HEADING), -8.0 * np.cos(HEADING), HEADING])
COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4


def drawn(cov=COV, rho=0.0, seed=0, count=N):
    """AR(1) errors of a covariance."""
    white = np.random.default_rng(seed).standard_normal((count, len(cov)))
    white[1:] *= math.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], white, axis=0) @ np.linalg.cholesky(cov).T


def stated(cov, count=N):
    return np.broadcast_to(cov, (count, *cov.shape))


def audited(poses, cov=COV, truth=TRUTH, **options):
    covs = cov if cov.ndim == 3 else stated(cov, len(poses))
    return ss.audit((STAMPS[: len(poses)], poses, covs), (STAMPS[: len(truth)], truth), **options)


def turned_by_heading(error):
    c, s = np.cos(HEADING), np.sin(HEADING)
    return np.column_stack([c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1], error[:, 2]])


@pytest.mark.parametrize(("scale", "outcome"), [(0.5, "overconfident"), (1.0, "consistent"), (2.0, "cautious")])
@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_the_verdict_and_the_factor_are_right_for_white_and_for_correlated_errors(rho, scale, outcome):
    found = audited(TRUTH + drawn(rho=rho, seed=1), scale * COV)
    assert found.outcome == outcome and found.verdict.startswith(outcome)
    low, high = found.findings.pose.interval
    assert low < 1.0 / scale < high
    assert found.findings.pose.samples < (1.05 * N if rho == 0.0 else 0.1 * N)


@pytest.mark.parametrize(("true", "read"), [("body", "world"), ("world", "body")])
def test_the_wrong_frame_is_noticed_since_the_nees_depends_on_the_heading(true, read):
    error = drawn(seed=5)
    poses = TRUTH + (turned_by_heading(error) if true == "body" else error)
    note = f"may have the axes of the {true}"
    assert note in repr(audited(poses, frame=read))
    assert "depends on the heading" not in repr(audited(poses, frame=true))
    isotropic = np.diag([0.01, 0.01, 1e-4])
    assert "depends on the heading" not in repr(audited(TRUTH + drawn(isotropic), isotropic, frame=read))


def of_short_runs(align, count, runs):
    """The audit of many short runs with white errors."""
    estimates = [(STAMPS[:count], TRUTH[:count] + drawn(seed=k, count=count), stated(COV, count)) for k in range(runs)]
    return ss.audit(estimates, [(STAMPS[:count], TRUTH[:count])] * runs, align=align)


def test_the_degrees_of_freedom_of_an_alignment_are_taken_off():
    """Without it the mean NEES of 40 poses would be 2.93."""
    found = of_short_runs("all", 40, 300)
    plain = float(np.mean(np.concatenate([run.nees for run in found.runs])))
    assert plain == pytest.approx(3.0 * (1.0 - 1.0 / 40), abs=0.05)
    assert found.findings.pose.nees == pytest.approx(plain / (1.0 - found.findings.removed)) != plain
