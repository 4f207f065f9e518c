"""The checkers of the seams, but that of estimators: parts that break their contract in one way alone are found."""

import dataclasses
import math

import numpy as np
import pytest

from sixthsense.config import FeaturesConfig
from sixthsense.core.motion import Odometry
from sixthsense.navigation.explorer import FrontierExplorer
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.features.extraction import LineExtractor
from sixthsense.slam.front_end import Finished
from sixthsense.slam.landmark_front_end import LandmarkFrontEnd
from sixthsense.slam.scans.place_search import BranchAndBound
from sixthsense.testing import (
    explorer_checks,
    extractor_checks,
    front_end_checks,
    navigation,
    perception,
    place_search_checks,
    planner_checks,
)
from sixthsense.testing.laws import Failures, agree, at_most, equal


class Elsewhere(AStar):
    def plan(self, space, start, goal):
        plan = super().plan(space, start, goal)
        if not plan.found:
            return plan
        path = plan.path_world.copy()
        path[-1] += 0.015
        return dataclasses.replace(plan, path_world=path)


class Forgetful(AStar):
    def __init__(self, rng=None):
        super().__init__(rng)
        self.asked = 0

    def plan(self, space, start, goal):
        self.asked += 1
        plan = super().plan(space, start, goal)
        return dataclasses.replace(plan, cost=plan.cost + 0.01 * self.asked)


class Writes(FrontierExplorer):
    def next_target(self, view):
        view.free[1, 2] ^= True
        return super().next_target(view)


class Unreachable(FrontierExplorer):
    def next_target(self, view):
        target = super().next_target(view)
        return None if target is None else dataclasses.replace(target, viewpoint=(-3, 2))


class Draws(FrontierExplorer):
    drawn = np.random.default_rng(3)

    def next_target(self, view):
        targets = view.targets()
        return targets[int(self.drawn.integers(len(targets)))] if targets else None


class Extracts(LineExtractor):
    """The shipped extractor, whose observations are changed."""

    Options = None

    def __init__(self, assumed):
        super().__init__(assumed, FeaturesConfig())

    def extract(self, scan):
        found = super().extract(scan)
        return dataclasses.replace(found, observations=tuple(map(self.changed, found.observations)))

    def changed(self, observation):
        return observation


class Overconfident(Extracts):
    def changed(self, observation):
        return dataclasses.replace(observation, cov=0.1 * observation.cov)


class Aside(Extracts):
    def changed(self, observation):
        return dataclasses.replace(observation, z=observation.z + np.array([0.4, 0.3]))


class FrontEnd:
    """The shipped front end of landmarks, with what is changed."""

    def __init__(self, setup):
        self.own = LandmarkFrontEnd(setup)

    pose = property(lambda self: self.own.pose)
    since = property(lambda self: self.own.since)

    def take(self, evidence):
        return self.own.take(evidence)

    def finish(self):
        return self.own.finish()


class TooSure(FrontEnd):
    def finish(self):
        found = self.own.finish().estimate
        return Finished(dataclasses.replace(found, pose_cov=0.05 * found.pose_cov))


class CountsFromOne(FrontEnd):
    def take(self, evidence):
        found = self.own.take(evidence)
        return None if found is None else dataclasses.replace(found, index=found.index + 1)


class Indefinite(FrontEnd):
    @property
    def since(self):
        return Odometry(self.own.since.motion, self.own.since.cov - 1e-3 * np.eye(3))


class Shifted(BranchAndBound):
    def propose(self, query):
        return [one._replace(pose=one.pose + np.array([0.9, -1.4, 0.2])) for one in super().propose(query)]


class Twice(BranchAndBound):
    def propose(self, query):
        return [one for one in super().propose(query) for _ in range(2)]


BROKEN = [
    (navigation.PLANNER_LAWS, Elsewhere, "a path joins start and goal through free cells at the cost it says"),
    (navigation.PLANNER_LAWS, Forgetful, "the same question has the same answer"),
    (navigation.EXPLORER_LAWS, Writes,
     "every target is of unseen cells and seen from where the robot can drive"),
    (navigation.EXPLORER_LAWS, Unreachable,
     "every target is of unseen cells and seen from where the robot can drive"),
    (navigation.EXPLORER_LAWS, Draws, "the same map and generator give the same targets"),
    (perception.EXTRACTOR_LAWS, Overconfident, "covariances are as large as errors"),
    (perception.EXTRACTOR_LAWS, Aside, "what is observed is there"),
    (perception.FRONT_END_LAWS, TooSure, "the covariance of the pose is as large as its errors"),
    (perception.FRONT_END_LAWS, CountsFromOne, "keyframes count from 0 and are the rows of the trajectory"),
    (perception.FRONT_END_LAWS, Indefinite, "the motion since the last keyframe has a covariance"),
    (perception.PLACE_LAWS, Shifted, "the place where the robot is is among what is proposed"),
    (perception.PLACE_LAWS, Twice, "candidates are poses of different places with scores the best first"),
]  # fmt: skip
"""the laws, a part that breaks one of them, and which"""


@pytest.mark.slow
@pytest.mark.parametrize(("laws", "part", "broken"), BROKEN, ids=[part.__name__ for _, part, _ in BROKEN])
def test_a_part_that_breaks_a_law_is_found_by_it_with_what_was_found(laws, part, broken):
    failures = Failures(part, [laws.named(broken)], {})
    assert "found" in failures[broken] and not failures.kept


CHECKS = [
    (planner_checks, AStar), (explorer_checks, FrontierExplorer), (extractor_checks, "lines"),
    (front_end_checks, "landmarks"), (place_search_checks, "branch-and-bound"),
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
    "share: found 0.75, allowed at most 0.2": lambda: at_most("share", 0.75, 0.2),
    "share: found nan, allowed at most 0.2": lambda: at_most("share", math.nan, 0.2),
    "z: found a difference of 1 at [1, 0], allowed 0.03": lambda: agree(
        "z", [[1, 2], [4, 5]], [[1, 2], [3, 5]], 0, 0.01
    ),
    "z: found a difference of inf at [1], allowed 0": lambda: agree("z", [1, math.nan], [1, 2]),
    "z: found shape (2,), allowed (3,)": lambda: agree("z", [1, 2], [1, 2, 3]),
    "ids: found [1], allowed [2]": lambda: equal("ids", [1], [2]),
}


@pytest.mark.parametrize("message", ASSERTIONS)
def test_an_assertion_of_a_law_has_what_was_found_and_what_is_allowed(message):
    with pytest.raises(AssertionError) as caught:
        ASSERTIONS[message]()
    assert str(caught.value) == message
    at_most("share", 0.2, 0.2)
    agree("z", [1.0, 2.001], [1, 2], 1e-3 + 1e-12)
