"""Checks of parts of your own against the contract of their seam."""

from __future__ import annotations

import numpy as np

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.estimators import EstimatorFactory
from sixthsense.testing import contract, edges, posterior, walls
from sixthsense.testing.estimation import make
from sixthsense.testing.laws import Verdicts, verdicts_of

LAWS = (*posterior.LAWS, *contract.LAWS, *edges.LAWS, *walls.LAWS, *edges.VALIDATION, *walls.VALIDATION)
"""of estimators"""


def check_estimator(estimator: str | EstimatorFactory, validation: bool = True) -> Verdicts:
    """Test an estimator, named or its class, against all laws of the `Estimator` contract, as the package's own.

    Statistics come first: mean and covariance beside those of batch least squares. What an estimator does with invalid
    input comes last, does not count for `kept`, and is left out without `validation`. If the estimator raises
    NotImplementedError for the first observation of a wall, the laws of walls are skipped.
    """
    return verdicts_of(LAWS, estimator, _refusal_of_walls(estimator), validation)


def _refusal_of_walls(estimator: str | EstimatorFactory) -> str:
    """The error with which an estimator refuses the first observation of a wall; empty if it does not."""
    try:
        make(estimator).update({0: Observation(Kind.WALL, np.array([0.5, -2.0]), 0.01 * np.eye(2), (-1.0, 1.0))})
    except NotImplementedError as error:
        return f"{type(error).__name__}: {error}"
    except Exception:  # the laws find it and name it
        return ""
    return ""
