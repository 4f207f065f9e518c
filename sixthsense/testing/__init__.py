"""Checks of parts against the contract of their seam, for shipped ones and your own, and consistency experiments.

from sixthsense.testing import check_estimator
check_estimator("lab.fading:Fading")
"""

from sixthsense.testing.check import (
    check_estimator,
    check_explorer,
    check_extractor,
    check_front_end,
    check_place_search,
    check_planner,
)
from sixthsense.testing.laws import Verdicts

__all__ = [
    "Verdicts",
    "check_estimator",
    "check_explorer",
    "check_extractor",
    "check_front_end",
    "check_place_search",
    "check_planner",
]
