"""Checks of parts against the contract of their seam, for shipped ones and your own, and consistency experiments.

from sixthsense.testing import check_estimator, estimator_checks
print(check_estimator("lab.fading:Fading"))

@pytest.mark.parametrize("name, check", estimator_checks(Fading))
def test_the_contract(name, check):
    check()
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.navigation.explorer import Explorer
from sixthsense.navigation.planners import PlannerFactory
from sixthsense.slam.estimators import Estimator, EstimatorFactory
from sixthsense.slam.features import Extractor
from sixthsense.slam.front_end import FrontEnd
from sixthsense.slam.scans.place_search import PlaceSearch
from sixthsense.testing.laws import Failures, Law, Laws, message_of, refuse

__all__ = [
    "Failures", "check_estimator", "check_explorer", "check_extractor", "check_front_end", "check_place_search",
    "check_planner", "estimator_checks", "explorer_checks", "extractor_checks", "front_end_checks",
    "place_search_checks", "planner_checks",
]  # fmt: skip

Checks = Iterator[tuple[str, Callable[[], None]]]
"""(name, check): a check without arguments raises an exception if the part breaks the law of that name"""


def check_estimator(estimator: str | EstimatorFactory) -> Failures:
    """Check an estimator, named or its class, against all laws of the `Estimator` contract, as the package's own.

    If it raises NotImplementedError for the first observation of a wall, the laws of walls are skipped.
    """
    return Failures(estimator, *_laws_of("estimator", estimator))


def estimator_checks(estimator: str | EstimatorFactory) -> Checks:
    """Laws that `check_estimator` tests.

    For pytest: `@pytest.mark.parametrize("name, check", estimator_checks(Mine))` above a test that calls `check()`.
    """
    return _checks("estimator", estimator)


def check_planner(planner: str | PlannerFactory) -> Failures:
    """Check a planner, named or its class, against all laws of the `Planner` contract, on maps with random blocks."""
    return Failures(planner, *_laws_of("planner", planner))


def planner_checks(planner: str | PlannerFactory) -> Checks:
    """Laws that `check_planner` tests, as `estimator_checks`."""
    return _checks("planner", planner)


def check_explorer(explorer: str | Callable[..., Explorer]) -> Failures:
    """Check an explorer, named or its class, against all laws of the `Explorer` contract, in two rooms with a door."""
    return Failures(explorer, *_laws_of("explorer", explorer))


def explorer_checks(explorer: str | Callable[..., Explorer]) -> Checks:
    """Laws that `check_explorer` tests, as `estimator_checks`."""
    return _checks("explorer", explorer)


def check_extractor(extractor: str | Callable[..., Extractor]) -> Failures:
    """Check an extractor, named or its class, against all laws of the `Extractor` contract, in a furnished room."""
    return Failures(extractor, *_laws_of("extractor", extractor))


def extractor_checks(extractor: str | Callable[..., Extractor]) -> Checks:
    """Laws that `check_extractor` tests, as `estimator_checks`."""
    return _checks("extractor", extractor)


def check_front_end(front_end: str | Callable[..., FrontEnd]) -> Failures:
    """Check a front end, named or its class, against all laws of the `FrontEnd` contract, on drives with isam2."""
    return Failures(front_end, *_laws_of("front_end", front_end))


def front_end_checks(front_end: str | Callable[..., FrontEnd]) -> Checks:
    """Laws that `check_front_end` tests, as `estimator_checks`."""
    return _checks("front_end", front_end)


def check_place_search(place_search: str | Callable[..., PlaceSearch]) -> Failures:
    """Check a place search, named or its class, against all laws of the `PlaceSearch` contract, in three rooms."""
    return Failures(place_search, *_laws_of("place_search", place_search))


def place_search_checks(place_search: str | Callable[..., PlaceSearch]) -> Checks:
    """Laws that `check_place_search` tests, as `estimator_checks`."""
    return _checks("place_search", place_search)


def _checks(kind: str, part: Any) -> Checks:
    return ((law.name, partial(law.check, part)) for law in _laws_of(kind, part)[0])


def _laws_of(kind: str, part: Any) -> tuple[list[Law], dict[str, str]]:
    """The laws to test of a kind of parts, and those to skip, with the reason.

    Of a part that cannot be made it is one law alone: that the part can be made.
    """
    from sixthsense.config import parts, preset
    from sixthsense.config.tree import make_part
    from sixthsense.navigation.planners import make_planner
    from sixthsense.testing import estimators, navigation, perception

    by_kind: dict[str, tuple[Callable[[], object], Laws]] = {
        "estimator": (lambda: _refusal_of_walls(estimators.make(part)), estimators.LAWS),
        "planner": (lambda: make_planner(part), navigation.PLANNER_LAWS),
        "explorer": (lambda: make_part(parts.EXPLORERS, part, np.random.default_rng(7)), navigation.EXPLORER_LAWS),
        "extractor": (lambda: perception.extractor_of(part, preset()), perception.EXTRACTOR_LAWS),
        "front_end": (lambda: perception.front_end_of(part, 0), perception.FRONT_END_LAWS),
        "place_search": (lambda: make_part(parts.PLACE_SEARCHES, part), perception.PLACE_LAWS),
    }
    make, laws = by_kind[kind]
    try:
        reason = make()
    except Exception as error:
        found = f"found {message_of(error)}, allowed: a part that its class makes"
        return [Law("the part can be made", lambda _: refuse(found))], {}
    if not isinstance(reason, NotImplementedError):
        return list(laws), {}
    skipped = {law.name: message_of(reason) for law in laws if law.needs_walls}
    return [law for law in laws if not law.needs_walls], skipped


def _refusal_of_walls(estimator: Estimator) -> Exception | None:
    """What an estimator raises for the first observation of a wall."""
    try:
        estimator.update({0: Observation(Kind.WALL, np.array([0.5, -2.0]), 0.01 * np.eye(2), (-1.0, 1.0))})
    except Exception as error:  # another one than NotImplementedError is found by the laws of walls
        return error
    return None
