"""The checkers of the seams: parts that break their contract in one way alone, or cannot be made, are found."""

import math
from dataclasses import replace

import numpy as np
import pytest
from point_world import broken

from sixthsense.core.motion import Odometry
from sixthsense.navigation.explorer import FrontierExplorer
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.features.extraction import LineExtractor
from sixthsense.slam.front_end import Finished
from sixthsense.slam.landmark_front_end import LandmarkFrontEnd
from sixthsense.slam.scans.place_search import BranchAndBound
from sixthsense.testing import (
    estimator_checks,
    explorer_checks,
    extractor_checks,
    front_end_checks,
    navigation,
    perception,
    place_search_checks,
    planner_checks,
)
from sixthsense.testing.laws import Failures, agree, at_most, equal


def ends_elsewhere(own, call, *given):
    plan = call(*given)
    if not plan.found:
        return plan
    return replace(plan, path_world=np.vstack([plan.path_world[:-1], plan.path_world[-1:] + 0.015]))


def costs_more_each_time(own, call, *given):
    own.asked = getattr(own, "asked", 0) + 1
    plan = call(*given)
    return replace(plan, cost=plan.cost + 0.01 * own.asked)


def writes(own, call, view):
    view.free[1, 2] ^= True
    return call(view)


def drawn(own, call, view, rng=np.random.default_rng(3)):  # noqa: B008
    targets = view.targets()
    return targets[int(rng.integers(len(targets)))] if targets else None


def of_result(change):
    """Changes what is returned, unless it is None."""

    def changed(own, call, *given):
        found = call(*given)
        return None if found is None else change(found)

    return changed


def observed(change):
    """The extractor of lines whose observations are changed."""
    of_features = of_result(lambda found: replace(found, observations=tuple(map(change, found.observations))))
    return broken(LineExtractor, extract=of_features)


def too_sure(found):
    return Finished(replace(found.estimate, pose_cov=0.05 * found.estimate.pose_cov))


class Indefinite:
    """The front end of landmarks with another covariance since the last keyframe."""

    def __init__(self, setup):
        self.own = LandmarkFrontEnd(setup)

    def __getattr__(self, name):
        return getattr(self.own, name)

    since = property(lambda self: Odometry(self.own.since.motion, self.own.since.cov - 1e-3 * np.eye(3)))


BROKEN = [
    (navigation.PLANNER_LAWS, broken(AStar, plan=ends_elsewhere),
     "a path joins start and goal through free cells at the cost it says"),
    (navigation.PLANNER_LAWS, broken(AStar, plan=costs_more_each_time), "the same question has the same answer"),
    (navigation.EXPLORER_LAWS, broken(FrontierExplorer, next_target=writes),
     "every target is of unseen cells and seen from where the robot can drive"),
    (navigation.EXPLORER_LAWS,
     broken(FrontierExplorer, next_target=of_result(lambda target: replace(target, viewpoint=(-3, 2)))),
     "every target is of unseen cells and seen from where the robot can drive"),
    (navigation.EXPLORER_LAWS, broken(FrontierExplorer, next_target=drawn),
     "the same map and generator give the same targets"),
    (perception.EXTRACTOR_LAWS, observed(lambda one: replace(one, cov=0.1 * one.cov)),
     "covariances are as large as errors"),
    (perception.EXTRACTOR_LAWS, observed(lambda one: replace(one, z=one.z + np.array([0.4, 0.3]))),
     "what is observed is there"),
    (perception.FRONT_END_LAWS, broken(LandmarkFrontEnd, finish=of_result(too_sure)),
     "the covariance of the pose is as large as its errors"),
    (perception.FRONT_END_LAWS,
     broken(LandmarkFrontEnd, take=of_result(lambda keyframe: replace(keyframe, index=keyframe.index + 1))),
     "keyframes count from 0 and are the rows of the trajectory"),
    (perception.FRONT_END_LAWS, Indefinite, "the motion since the last keyframe has a covariance"),
    (perception.PLACE_LAWS, broken(BranchAndBound, propose=of_result(
        lambda found: [one._replace(pose=one.pose + np.array([0.9, -1.4, 0.2])) for one in found])),
     "the place where the robot is is among what is proposed"),
    (perception.PLACE_LAWS, broken(BranchAndBound, propose=of_result(
        lambda found: [one for one in found for _ in range(2)])),
     "candidates are poses of different places with scores the best first"),
]  # fmt: skip
"""the laws, a part that breaks one of them, and which"""


@pytest.mark.slow
@pytest.mark.parametrize(("laws", "part", "law"), BROKEN, ids=[law for *_, law in BROKEN])
def test_a_part_that_breaks_a_law_is_found_by_it_with_what_was_found(laws, part, law):
    failures = Failures(part, [laws.named(law)], {})
    assert "found" in failures[law] and not failures.kept


CHECKS = [
    (estimator_checks, "ekf"), (planner_checks, AStar), (explorer_checks, FrontierExplorer),
    (extractor_checks, "lines"), (front_end_checks, "landmarks"), (place_search_checks, "branch-and-bound"),
]  # fmt: skip


@pytest.mark.parametrize(("checks", "part"), CHECKS, ids=[checks.__name__ for checks, _ in CHECKS])
def test_what_cannot_be_made_is_told_once(checks, part):
    class Fails:
        def __init__(self, *given):
            raise TypeError("nothing fits")

    ((name, check),) = checks(Fails)
    assert name == "the part can be made"
    with pytest.raises(AssertionError, match=r"^found .*nothing fits.*, allowed: a part that its class makes$"):
        check()
    assert len([*checks(part)]) > 1


ASSERTIONS = {
    "share: found 0.75, allowed at most 0.2": (at_most, 0.75, 0.2),
    "share: found nan, allowed at most 0.2": (at_most, math.nan, 0.2),
    "z: found a difference of 1 at [1, 0], allowed 0.03": (agree, [[1, 2], [4, 5]], [[1, 2], [3, 5]], 0, 0.01),
    "z: found a difference of inf at [1], allowed 0": (agree, [1, math.nan], [1, 2]),
    "z: found shape (2,), allowed (3,)": (agree, [1, 2], [1, 2, 3]),
    "ids: found [1], allowed [2]": (equal, [1], [2]),
}


@pytest.mark.parametrize("message", ASSERTIONS)
def test_an_assertion_of_a_law_has_what_was_found_and_what_is_allowed(message):
    law, *given = ASSERTIONS[message]
    with pytest.raises(AssertionError) as caught:
        law(message.partition(":")[0], *given)
    assert str(caught.value) == message
    at_most("share", 0.2, 0.2)
    agree("z", [1.0, 2.001], [1, 2], 1e-3 + 1e-12)
