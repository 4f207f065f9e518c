"""The effective number of samples is that of independent ones whose mean scatters as much."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from sixthsense.evaluation.consistency import (
    Consistency,
    consistency,
    effective_number,
    effective_samples,
    effective_samples_of_errors,
    whitened_errors,
)

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


def test_the_number_lies_between_one_and_all_samples():
    alternating = [np.tile([[1.0], [-1.0]], (50, 1)) * np.linspace(1.0, 2.0, 100)[:, None]]
    assert 1.0 <= effective_number(squares(alternating), alternating) <= 100.0
    assert effective_samples([np.full(10, 3.0)]) == 1.0 and effective_samples([]) == 0.0


def products(series):
    """Sums of products at each lag, over series of which the longest is the first, by plain sums."""
    return [sum(float(one[k:] @ one[: len(one) - k]) for one in series if len(one) > k) for k in range(len(series[0]))]


def initial(rho):
    """Lags of the initial positive sequence: pairs, up to the first whose sum is not positive."""
    return next((k for k in range(0, len(rho) - 1, 2) if rho[k] + rho[k + 1] <= 0.0), len(rho))


def test_both_numbers_are_those_of_plain_sums_over_pairs_of_lags():
    rng = np.random.default_rng(4)
    runs = [np.cumsum(rng.normal(0.03, 1.0, (count, 3)), axis=0) * [0.4, 1.1, 0.7] for count in (61, 40)]
    nees, count = [np.sum(one**2, axis=1) for one in runs], 101
    about = [one - np.concatenate(nees).mean() for one in nees]
    rho = np.array(products(about)) / products(about)[0]
    assert effective_samples(nees) == pytest.approx(count / (2.0 * rho[: initial(rho)].sum() - 1.0))
    axes = np.array([products([one[:, k] for one in runs]) for k in range(3)])
    rho = axes.sum(axis=0) / axes[:, 0].sum()
    end = initial(rho)
    squared = (axes[:, :end] ** 2).sum() / (axes[:, 0] ** 2).sum()
    expected = count / (2.0 * squared - 1.0), count / (2.0 * rho[:end].sum() - 1.0)
    assert effective_samples_of_errors(runs) == pytest.approx(expected)
    assert len({*expected, effective_samples(nees)}) == 3 and max(expected) < 50.0
    assert effective_number(nees, runs) == pytest.approx(min(expected[0], effective_samples(nees)))
    assert effective_number(nees[:1], errors(0.0, 3)) == effective_samples(nees[:1])


@pytest.mark.parametrize(
    ("nees", "samples", "outcome"),
    [
        (4.1, 29.9, "too short to tell"), (4.1, 30.0, "overconfident"), (3.0, 30.0, "consistent"),
        (2.1, 30.0, "cautious"), (2.1, 29.9, "too short to tell"), (3.6, 30.0, "consistent"),
        (3.6, 90.0, "overconfident"),
    ],
)  # fmt: skip
def test_a_verdict_needs_thirty_samples_and_flips_where_the_mean_leaves_its_band(nees, samples, outcome):
    found = Consistency(nees, samples)
    low, high = chi2.ppf((0.025, 0.975), 3 * samples) / samples
    assert found.band == pytest.approx((low, high)) and found.interval == pytest.approx((nees / high, nees / low))
    assert found.outcome == outcome and str(found).startswith(f"{outcome}: NEES {nees:.2f}, {low:.2f} to {high:.2f} is")
    assert (low <= nees <= high) == (found.interval[0] <= 1.0 <= found.interval[1])


def test_a_nees_beyond_any_chance_is_named_though_the_run_is_too_short():
    limit = float(chi2.ppf(0.999, 3))
    assert "no chance" in str(Consistency(limit + 0.1, 4.0)) and "no chance" not in str(Consistency(limit - 0.1, 4.0))


def test_the_mean_and_the_samples_of_runs_are_those_of_their_nees_and_heavy_tails_count_as_fewer():
    rng, runs = np.random.default_rng(8), []
    for count in (400, 250):
        root = rng.uniform(-0.3, 0.3, (count, 3, 3)) + np.eye(3)
        runs.append(((root @ rng.standard_t(4, (count, 3, 1)))[:, :, 0], root @ root.transpose(0, 2, 1)))
    nees = [np.array([e @ np.linalg.solve(c, e) for e, c in zip(*run, strict=True)]) for run in runs]
    together = np.concatenate(nees)
    plain = effective_number(nees, [whitened_errors(*run) for run in runs])
    heavy = 2.0 * together.mean() ** 2 / 3 / together.var()
    assert heavy < 0.7
    found = consistency(runs)
    assert (found.nees, found.samples) == (pytest.approx(together.mean()), pytest.approx(plain * heavy))
