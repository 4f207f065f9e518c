"""The checkers of the seams, but that of estimators: parts that break their contract in one way alone are found."""

import dataclasses
import importlib

import numpy as np
import pytest

from sixthsense import testing
from sixthsense.config import FeaturesConfig
from sixthsense.core.motion import Odometry
from sixthsense.navigation.explorer import FrontierExplorer
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.features.extraction import LineExtractor
from sixthsense.slam.front_end import Finished
from sixthsense.slam.landmark_front_end import landmark_front_end
from sixthsense.slam.scans.place_search import BranchAndBound
from sixthsense.testing import navigation, perception, places


class TooLong(AStar):
    def plan(self, space, start, goal):
        return dataclasses.replace(super().plan(space, start, goal), cost=7.25)


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

    def __init__(self, assumed, rng):
        super().__init__(assumed, rng, FeaturesConfig())

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
        self.own = landmark_front_end(setup)

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


class WorstFirst(BranchAndBound):
    def propose(self, query):
        found = super().propose(query)
        return [one._replace(score=0.1 + 0.2 * k) for k, one in enumerate([*found, *found])]


BROKEN = [
    (navigation.PLANNER_LAWS, TooLong, "a_path_joins_start_and_goal_through_free_cells_at_the_length_it_says"),
    (navigation.PLANNER_LAWS, Elsewhere, "a_path_joins_start_and_goal_through_free_cells_at_the_length_it_says"),
    (navigation.PLANNER_LAWS, Forgetful, "the_same_question_has_the_same_answer"),
    (navigation.EXPLORER_LAWS, Writes, "the_view_stays_as_it_is"),
    (navigation.EXPLORER_LAWS, Unreachable,
     "every_target_is_of_unseen_cells_and_seen_from_where_the_robot_can_drive"),
    (navigation.EXPLORER_LAWS, Draws, "the_same_map_and_generator_give_the_same_targets"),
    (perception.EXTRACTOR_STATISTICS, Overconfident, "covariances_are_as_large_as_errors"),
    (perception.EXTRACTOR_STATISTICS, Aside, "what_is_observed_is_there"),
    (perception.FRONT_END_STATISTICS, TooSure, "the_covariance_of_the_pose_is_as_large_as_its_errors"),
    (perception.FRONT_END_LAWS, CountsFromOne, "keyframes_count_from_0_and_are_the_rows_of_the_trajectory"),
    (perception.FRONT_END_LAWS, Indefinite, "the_motion_since_the_last_keyframe_has_a_covariance"),
    (places.STATISTICS, Shifted, "the_place_where_the_robot_is_is_among_what_is_proposed"),
    (places.LAWS, Twice, "candidates_are_of_different_places"),
    (places.LAWS, WorstFirst, "candidates_are_poses_with_scores_the_best_first"),
]  # fmt: skip
"""the laws, a part that breaks one of them, and which"""


@pytest.mark.slow
@pytest.mark.parametrize(("laws", "part", "broken"), BROKEN, ids=[part.__name__ for _, part, _ in BROKEN])
def test_a_part_that_breaks_a_law_is_found_by_it_with_numbers(laws, part, broken):
    (law,) = (law for law in laws if law.name == broken)
    verdicts = testing.check.verdicts_of([law], part)
    assert verdicts[broken].startswith(("found", "nothing")) and not verdicts.kept


LAWS = """
import math

import numpy as np

from sixthsense.testing.laws import Laws

LAWS = Laws("statistics")


@LAWS.law
def a_share_is_small(part):
    share = part / 4.0
    assert share <= 0.2


@LAWS.law
def arrays_agree(part):
    found, allowed = np.array([[1.0, 2.5], [3.0, part]]), np.array([[1.0, 2.5], [3.0, 4.0]])
    assert math.isfinite(part) and np.allclose(found, allowed, rtol=0.0, atol=0.01)
"""


def test_a_failure_of_a_law_has_what_was_found_and_what_is_allowed(tmp_path, monkeypatch):
    """The laws are in a file that pytest does not rewrite: it would say more of a plain assertion."""
    (tmp_path / "plain_laws.py").write_text(LAWS)
    monkeypatch.syspath_prepend(tmp_path)
    laws = importlib.import_module("plain_laws").LAWS
    verdicts = testing.check.verdicts_of(laws, 3.0)
    assert verdicts["a_share_is_small"] == "found 0.75, allowed <= 0.2 (share <= 0.2)"
    assert verdicts["arrays_agree"].startswith("found a difference of 1 at [1, 1], allowed 0.01 (np.allclose(found")
    assert repr(verdicts).splitlines()[0] == "statistics: breaks 2 of 2 laws"
    assert testing.check.verdicts_of(laws, 0.4)["a_share_is_small"] == ""
