"""Checks of parts against the contract of their seam, for shipped ones and your own, and consistency experiments.

from sixthsense.testing import check_estimator
check_estimator(MyEstimator)
"""

from sixthsense.testing.check import check_estimator
from sixthsense.testing.laws import Verdicts

__all__ = ["Verdicts", "check_estimator"]
