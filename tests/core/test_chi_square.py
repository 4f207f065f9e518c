import numpy as np
from scipy.stats import chi2

from sixthsense.core.covariance import chi_square_quantile


def test_quantiles_are_those_of_scipy_to_the_last_bit():
    dof = np.arange(1, 300)
    for probability in (0.025, 0.5, 0.95, 0.999, 0.999999, 1.0):
        assert np.array_equal(chi_square_quantile(probability, dof), chi2.ppf(probability, dof))
        assert chi_square_quantile(probability, 3) == chi2.ppf(probability, 3)
