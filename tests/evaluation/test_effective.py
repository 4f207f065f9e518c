"""The effective number of samples is that of independent ones whose mean scatters as much."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sixthsense.evaluation.effective import effective_number, effective_samples, effective_samples_of_errors

LENGTH = 4000


def errors(rho, seed, runs=1, axes=3):
    """Stationary AR(1) errors of unit variance, an array per run."""
    rng = np.random.default_rng(seed)
    noise = np.sqrt(1.0 - rho**2) * rng.standard_normal((runs, LENGTH, axes))
    noise[:, 0] = rng.standard_normal((runs, axes))
    return list(lfilter([1.0], [1.0, -rho], noise, axis=1))


def squares(series):
    return [np.sum(one**2, axis=1) for one in series]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_mean_of_autoregressive_errors_has_the_number_that_theory_says(rho):
    """The NEES of AR(1) errors has the autocorrelation rho^2k."""
    expected = LENGTH * (1.0 - rho**2) / (1.0 + rho**2)
    found = [effective_number(squares(one), one) for one in (errors(rho, seed) for seed in range(20))]
    assert 0.85 * expected < np.mean(found) <= 1.05 * expected


def test_neither_number_depends_on_the_scale_of_the_covariance():
    one = errors(0.9, 3)
    large = [3.0 * part for part in one]
    assert effective_number(squares(large), large) == pytest.approx(effective_number(squares(one), one))


def test_independent_runs_add_their_samples():
    runs = errors(0.9, 1, runs=6)
    alone = np.mean([effective_samples(squares([one])) for one in runs])
    assert effective_samples(squares(runs)) == pytest.approx(6.0 * alone, rel=0.25)


def test_an_error_that_lasts_the_whole_run_is_seen_in_its_sign_and_between_runs_but_not_in_the_nees_of_one_run():
    runs = [
        0.2 * one + offset
        for one, offset in zip(errors(0.0, 2, runs=6), (1.0, -2.0, 1.5, -0.6, 0.8, -1.8), strict=True)
    ]
    assert effective_samples(squares(runs[:1])) > 0.5 * LENGTH
    assert effective_samples_of_errors(runs[:1])[0] < 3.0
    assert effective_samples(squares(runs)) < 12.0


def test_the_number_lies_between_one_and_all_samples():
    alternating = [np.tile([[1.0], [-1.0]], (50, 1)) * np.linspace(1.0, 2.0, 100)[:, None]]
    assert 1.0 <= effective_number(squares(alternating), alternating) <= 100.0
    assert effective_samples([np.full(10, 3.0)]) == 1.0 and effective_samples([]) == 0.0
