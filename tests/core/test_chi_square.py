import numpy as np
import pytest
from scipy.stats import chi2, norm

from sixthsense.core.covariance import chi_square_quantile, mean_square_limit


def test_quantiles_are_those_of_scipy_to_the_last_bit():
    dof = np.arange(1, 300)
    for probability in (0.025, 0.5, 0.95, 0.999, 0.999999, 1.0):
        assert np.array_equal(chi_square_quantile(probability, dof), chi2.ppf(probability, dof))
        assert chi_square_quantile(probability, 3) == chi2.ppf(probability, 3)


@pytest.mark.parametrize("sigmas", [3.0, -3.0, 1.5])
@pytest.mark.parametrize("count", [20.0, 33.3, 400.0])
def test_a_mean_of_squares_is_limited_as_a_normal_is(count, sigmas):
    exact = chi2.ppf(norm.cdf(sigmas), count) / count
    assert mean_square_limit(count, sigmas) == pytest.approx(exact, rel=0.01, abs=0.005)
