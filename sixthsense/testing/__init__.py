"""Tests of estimators: the laws of their contract, for built-in and registered ones, and consistency experiments.

from sixthsense.testing import check_estimator
check_estimator(MyEstimator)
"""

from sixthsense.testing.check import Verdicts, check_estimator

__all__ = ["Verdicts", "check_estimator"]
