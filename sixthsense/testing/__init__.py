"""What tests an estimator: the contract's laws, for those that ship and for one's own; and experiments on consistency.

from sixthsense.testing import check_estimator
check_estimator(MyEstimator)
"""

from sixthsense.testing.check import Verdicts, check_estimator

__all__ = ["Verdicts", "check_estimator"]
