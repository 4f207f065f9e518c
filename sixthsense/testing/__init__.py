"""Checks of parts against the contract of their seam, for shipped ones and your own, and consistency experiments.

from sixthsense.testing import check_estimator, estimator_checks
print(check_estimator("lab.fading:Fading"))

@pytest.mark.parametrize("name, check", estimator_checks(Fading))
def test_the_contract(name, check):
    check()
"""

from sixthsense.testing.check import (
    check_estimator,
    check_explorer,
    check_extractor,
    check_front_end,
    check_place_search,
    check_planner,
    estimator_checks,
    explorer_checks,
    extractor_checks,
    front_end_checks,
    place_search_checks,
    planner_checks,
)
from sixthsense.testing.laws import Failures

__all__ = [
    "Failures",
    "check_estimator",
    "check_explorer",
    "check_extractor",
    "check_front_end",
    "check_place_search",
    "check_planner",
    "estimator_checks",
    "explorer_checks",
    "extractor_checks",
    "front_end_checks",
    "place_search_checks",
    "planner_checks",
]
