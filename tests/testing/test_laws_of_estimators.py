"""Each clause of the contract of estimators has estimators that break it, and the law that finds them."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from laws import links, parameters, prior_map

from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimator, Filter, Smoother, register_estimator
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing import check_estimator
from sixthsense.testing.check import LAWS
from sixthsense.testing.estimation import CONVERGED

CHECKS = {law.name: law.check for law in (*LAWS, *parameters.LAWS, *prior_map.LAWS, *links.LAWS)}
LEAST_SQUARES = "a_drive_gives_the_posterior_of_batch_least_squares [{}]"
FIRST_UPDATE = "the_first_update_gives_the_posterior_of_batch_least_squares [{}]"
NEW = "new_landmarks_have_the_joint_covariance_of_batch_least_squares [{}]"
ADDED = "an_update_adds_the_information_of_its_observations [{}]"
ORDERED = "the_joint_covariance_is_symmetric_positive_definite_and_in_the_requested_order"


def scaled(observations, factor, chosen=lambda i: True):
    """Observations whose covariance is `factor` times as large, where they are chosen."""
    return {i: dataclasses.replace(s, cov=factor * s.cov) if chosen(i) else s for i, s in observations.items()}


class Told(EKF):
    """Says a covariance that is `factor` times as large."""

    factor = 1.0

    def estimate(self):
        estimate = super().estimate()
        return dataclasses.replace(estimate, pose_cov=self.factor * estimate.pose_cov)

    def joint_covariance(self, ids):
        return self.factor * super().joint_covariance(ids)


class ShrinksAsItMoves(Told):
    def predict(self, odometry):
        super().predict(odometry)
        self.factor *= 0.99


class AddsNoNoise(EKF):
    def predict(self, odometry):
        super().predict(Odometry(odometry.motion, np.zeros((3, 3))))


class TurnsNoNoise(EKF):
    """Takes the noise of a motion in world axes."""

    def predict(self, odometry):
        turn = self.estimate().pose.adjoint()
        turn[:2, 2] = 0.0
        super().predict(Odometry(odometry.motion, turn.T @ odometry.cov @ turn))


class LosesMotions(EKF):
    """Moves by the latest of several motions before an update, and reads it only then."""

    _latest = None

    def predict(self, odometry):
        self._latest = odometry

    def _move(self):
        if self._latest is not None:
            super().predict(self._latest)
        self._latest = None

    def update(self, observations):
        self._move()
        super().update(observations)

    def estimate(self):
        self._move()
        return super().estimate()

    def joint_covariance(self, ids):
        self._move()
        return super().joint_covariance(ids)


def with_other_covariance(factor, of_known):
    """Uses observations of known landmarks, or of new ones, with `factor` times their covariance."""

    class OtherCovariance(EKF):
        def update(self, observations):
            known = {*self.estimate().ids.tolist()}
            super().update(scaled(observations, factor, lambda i: (i in known) == of_known))

    return OtherCovariance


class NoiseFloor(EKF):
    def update(self, observations):
        floor = 2.5e-8 * np.eye(2)
        super().update({i: dataclasses.replace(s, cov=s.cov + floor) for i, s in observations.items()})


class CountsTwice(EKF):
    """Uses an observation again if the landmark was seen in the update before, too."""

    last = ()

    def update(self, observations):
        super().update(scaled(observations, 0.5, lambda i: i in self.last))
        self.last = tuple(observations)


class AugmentsFirst(EKF):
    def update(self, observations):
        known = {*self.estimate().ids.tolist()}
        super().update({i: s for i, s in observations.items() if i not in known})
        super().update({i: s for i, s in observations.items() if i in known})


class AugmentsAlone(EKF):
    """Lets new landmarks know nothing of each other and of the pose."""

    def joint_covariance(self, ids):
        joint = super().joint_covariance(ids)
        joint[3:, :3] = joint[:3, 3:] = 0.0
        return joint


class RemembersTheForgotten(EKF):
    """Hides forgotten landmarks, and finds them again."""

    _hidden = frozenset()

    def forget(self, ids):
        if unknown := {*ids} - {*self.estimate().ids.tolist()}:
            raise KeyError(unknown)
        self._hidden |= {*ids}

    def update(self, observations):
        self._hidden -= {*observations}
        super().update(observations)

    def estimate(self):
        found = super().estimate()
        kept = ~np.isin(found.ids, [*self._hidden])
        return dataclasses.replace(found, ids=found.ids[kept], landmarks=found.landmarks[kept], walls=found.walls[kept])


class ForgetsAnother(EKF):
    def forget(self, ids):
        known = self.estimate().ids.tolist()
        super().forget([known[(known.index(i) + 1) % len(known)] for i in ids])


class ForgetsUpToAnUnknownOne(EKF):
    def forget(self, ids):
        for i in ids:
            super().forget([i])


class SurerAfterNothing(Told):
    def update(self, observations):
        super().update(observations)
        self.factor *= 1.0 if observations else 0.999


def with_joint(change):
    """Changes the joint covariance; `change` takes it and the number of landmarks."""

    class OtherJoint(EKF):
        def joint_covariance(self, ids):
            joint = super().joint_covariance(ids)
            change(joint, len(ids))
            return joint

    OtherJoint.__name__ = change.__name__
    return OtherJoint


def asymmetric(joint, _):
    joint[1, 0] *= 1.0 + 1e-12


def indefinite(joint, landmarks):
    joint -= 1.001 * np.linalg.eigvalsh(joint)[0] * np.eye(len(joint)) if landmarks else 0.0


def other_pose(joint, landmarks):
    joint[0, 0] *= 1.0 + 1e-9 if landmarks else 1.0


def transposed(joint, landmarks):
    for i, j in itertools.permutations(range(landmarks), 2):
        block = joint[3 + 2 * i : 5 + 2 * i, 3 + 2 * j : 5 + 2 * j]
        if i < j:
            block[:] = block.T.copy()
            joint[3 + 2 * j : 5 + 2 * j, 3 + 2 * i : 5 + 2 * i] = block.T


def halved(joint, landmarks):
    for i, j in itertools.permutations(range(landmarks), 2):
        joint[3 + 2 * i : 5 + 2 * i, 3 + 2 * j : 5 + 2 * j] *= 0.5


class SortsIds(EKF):
    def joint_covariance(self, ids):
        return super().joint_covariance(sorted(ids))


class LeavesOutUnknownIds(EKF):
    def joint_covariance(self, ids):
        return super().joint_covariance([i for i in ids if i in self.estimate().ids])


def returning_views(call):
    """Returns the same array of one of the calls until the state changes."""

    class Views(EKF):
        def __init__(self, start, start_cov):
            super().__init__(start, start_cov)
            self._kept = {}

        def predict(self, odometry):
            super().predict(odometry)
            self._kept = {}

        def update(self, observations):
            super().update(observations)
            self._kept = {}

    def kept(self, *args):
        key = str(args)
        if key not in self._kept:
            self._kept[key] = getattr(EKF, call)(self, *args)
        return self._kept[key]

    setattr(Views, call, kept)
    Views.__name__ = f"views_{call}"
    return Views


class Random(EKF):
    """Returns a position that differs by 1e-12 m from call to call."""

    _numbers = itertools.count()

    def estimate(self):
        estimate = super().estimate()
        pose = dataclasses.replace(estimate.pose, x=estimate.pose.x + 1e-12 * next(self._numbers))
        return dataclasses.replace(estimate, pose=pose)


class TakesAnyMotion(EKF):
    def predict(self, odometry):
        try:
            super().predict(odometry)
        except ValueError:
            super().predict(Odometry(odometry.motion, 1e-4 * np.eye(3)))


class TakesAnyObservation(EKF):
    def update(self, observations):
        try:
            super().update(observations)
        except ValueError:
            super().update({})


class TakesAnyStart(EKF):
    def __init__(self, start, start_cov):
        try:
            super().__init__(start, start_cov)
        except ValueError:
            super().__init__(start, np.eye(3))


class RefusesLate(EKF):
    """Uses the observations before the invalid one."""

    def update(self, observations):
        for i, observation in observations.items():
            super().update({i: observation})


class NamesNothing(EKF):
    def update(self, observations):
        try:
            super().update(observations)
        except ValueError:
            raise ValueError("invalid input") from None


class RefusesAnExactStart(EKF):
    def __init__(self, start, start_cov):
        np.linalg.cholesky(start_cov)
        super().__init__(start, start_cov)


class PointsOnly(EKF):
    """Refuses walls as the contract says."""

    error = NotImplementedError

    def update(self, observations):
        if any(observation.is_wall for observation in observations.values()):
            raise self.error("walls are not supported")
        super().update(observations)


class LateRefusal(PointsOnly):
    def update(self, observations):
        EKF.update(self, {i: observation for i, observation in observations.items() if not observation.is_wall})
        super().update({i: observation for i, observation in observations.items() if observation.is_wall})


class TypeErrorForWalls(PointsOnly):
    error = TypeError


class UnflaggedWalls(EKF):
    def estimate(self):
        estimate = super().estimate()
        return dataclasses.replace(estimate, walls=np.zeros_like(estimate.walls))


class DropsTheFirstRow(EKF):
    def trajectory(self):
        return super().trajectory()[1:]


class UsesThePriorTwice(EKF):
    def start_from(self, prior):
        super().start_from(dataclasses.replace(prior, cov=0.5 * prior.cov))


class RenamesThePrior(EKF):
    def start_from(self, prior):
        super().start_from(dataclasses.replace(prior, ids=prior.ids + 1))


class ConditionsOnTheForgotten(EKF):
    """Leaves the conditional covariance of the others where it should leave the marginal one."""

    def joint_covariance(self, ids):
        joint, every = super().joint_covariance(ids), super().estimate().ids.tolist()
        if not self._forgotten:
            return joint
        whole = self._before.joint_covariance([*every, *self._forgotten])
        n = 3 + 2 * len(every)
        return whole[:n, :n] - whole[:n, n:] @ np.linalg.solve(whole[n:, n:], whole[n:, :n])

    _forgotten = ()
    _before = None

    def start_from(self, prior):
        super().start_from(prior)
        self._before = EKF(self.estimate().pose, self.estimate().pose_cov)
        self._before.start_from(prior)

    def forget(self, ids):
        self._forgotten = tuple(ids)
        super().forget(ids)


class IgnoresTheWheels(EKF):
    def predict(self, odometry):
        super().predict(dataclasses.replace(odometry, wheels=None))


class LearnsOfWheelsFromAnything(EKF):
    def wheels(self):
        found = super().wheels()
        return found if found is None else dataclasses.replace(found, cov=0.999 * found.cov)


class IgnoresTheSensor(EKF):
    def update(self, observations):
        super().update({i: dataclasses.replace(s, sensor=None) for i, s in observations.items()})


class Smooths(ISAM2):
    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)


class SureOfLinks(Smooths):
    def link(self, links):
        return super().link(
            [dataclasses.replace(k, relative=Odometry(k.relative.motion, 0.25 * k.relative.cov)) for k in links]
        )


class KeepsLinks(Smooths):
    def unlink(self, ids):
        if len({*ids}) < len(list(ids)):
            raise KeyError(ids)


class ReturnsTheLastRows(Smooths):
    def poses_at(self, updates):
        rows = super().poses_at(updates)
        return self.trajectory()[len(self.trajectory()) - len(rows) :]


BROKEN = [
    (1, ShrinksAsItMoves, "predict_never_shrinks_the_joint_covariance"),
    (1, AddsNoNoise, FIRST_UPDATE.format("points")),
    (1, TurnsNoNoise, LEAST_SQUARES.format("walls")),
    (1, LosesMotions, "predicting_in_pieces_is_predicting_at_once"),
    (2, with_other_covariance(0.25, of_known=True), FIRST_UPDATE.format("points")),
    (2, with_other_covariance(0.9, of_known=True), FIRST_UPDATE.format("walls")),
    (2, with_other_covariance(0.9, of_known=True), ADDED.format("points and walls")),
    (2, with_other_covariance(1.1, of_known=False), NEW.format("points")),
    (2, with_other_covariance(0.9, of_known=False), NEW.format("walls")),
    (2, with_other_covariance(1.1, of_known=False), "a_new_landmark_is_initialized_from_its_observation"),
    (2, with_other_covariance(1.1, of_known=False), "a_new_wall_is_initialized_from_its_observation"),
    (2, NoiseFloor, "two_updates_with_one_observation_equal_one_with_half_its_covariance [points]"),
    (2, CountsTwice, "the_order_of_two_updates_makes_no_difference [walls]"),
    (2, AugmentsFirst, "known_landmarks_of_a_scan_update_before_new_ones_are_initialized"),
    (2, AugmentsAlone, "a_new_landmark_is_initialized_from_its_observation"),
    (2, RemembersTheForgotten, "a_forgotten_landmark_seen_again_is_new"),
    (2, ForgetsAnother, "forgetting_a_landmark_leaves_the_others_unchanged"),
    (2, ForgetsAnother, "forgetting_a_wall_leaves_the_others_unchanged"),
    (2, ForgetsUpToAnUnknownOne, "forgetting_an_unknown_landmark_is_a_key_error_and_changes_nothing"),
    (2, DropsTheFirstRow, "the_trajectory_has_one_row_per_update_and_starts_empty"),
    (3, SurerAfterNothing, "an_empty_update_leaves_the_covariance_alone"),
    (4, with_joint(asymmetric), ORDERED),
    (4, with_joint(indefinite), ORDERED),
    (4, with_joint(other_pose), ORDERED),
    (4, SortsIds, ORDERED),
    (4, SortsIds, "the_joint_covariance_of_points_and_walls_is_in_the_requested_order"),
    (4, LeavesOutUnknownIds, ORDERED),
    (4, with_joint(transposed), LEAST_SQUARES.format("points")),
    (4, with_joint(halved), LEAST_SQUARES.format("walls")),
    (5, returning_views("estimate"), "returned_arrays_are_copies"),
    (5, returning_views("joint_covariance"), "returned_arrays_are_copies"),
    (5, returning_views("trajectory"), "returned_arrays_are_copies"),
    (5, LosesMotions, "arguments_may_change_after_the_call"),
    (6, Random, "the_same_input_gives_the_same_bits"),
    (7, TakesAnyStart, "an_invalid_start_covariance_is_named [not finite]"),
    (7, TakesAnyMotion, "an_invalid_odometry_covariance_is_named_and_changes_nothing [an eigenvalue of -0.01]"),
    (7, TakesAnyObservation, "an_invalid_observation_is_named_and_changes_nothing [a singular covariance]"),
    (7, RefusesLate, "an_invalid_observation_is_named_and_changes_nothing [an asymmetric matrix]"),
    (7, NamesNothing, "the_error_of_an_observation_names_its_landmark"),
    (7, NamesNothing, "an_invalid_observation_of_a_wall_is_named_and_changes_nothing [an eigenvalue of -0.01]"),
    (7, RefusesAnExactStart, "a_drive_from_an_exact_start_never_fails [0]"),
    (8, LateRefusal, "a_scan_with_a_wall_is_used_or_refused_as_a_whole"),
    (8, TypeErrorForWalls, "a_scan_with_a_wall_is_used_or_refused_as_a_whole"),
    (8, UnflaggedWalls, "a_wall_is_returned_as_a_wall"),
    (9, UsesThePriorTwice, "the_first_observations_add_their_information_to_the_prior [points]"),
    (9, RenamesThePrior, "before_any_motion_the_landmarks_are_their_prior_and_independent_of_the_start [walls]"),
    (9, ConditionsOnTheForgotten, "a_forgotten_landmark_leaves_the_marginal_of_the_others [points and walls]"),
    (10, IgnoresTheWheels, "a_drive_with_uncertain_wheels_gives_the_posterior_of_batch_least_squares [points]"),
    (10, LearnsOfWheelsFromAnything, "odometry_that_does_not_depend_on_the_wheels_leaves_them_alone"),
    (11, IgnoresTheSensor, "parameters_and_pose_converge_to_the_truth_as_noise_goes_to_zero [sensor]"),
    (12, LearnsOfWheelsFromAnything, "before_any_motion_the_parameters_keep_their_prior [wheels]"),
    (13, SureOfLinks, "links_give_the_least_squares_solution"),
    (14, KeepsLinks, "removed_links_leave_no_trace"),
    (15, ReturnsTheLastRows, "poses_at_some_updates_are_rows_of_the_trajectory"),
]
"""clause of the contract, an estimator that breaks it, and the law that is to find it"""


@pytest.mark.parametrize(("clause", "cls", "law"), BROKEN, ids=lambda one: getattr(one, "__name__", str(one)))
def test_an_estimator_that_breaks_a_clause_breaks_its_law(clause, cls, law):
    honest = Smooths if clause > 12 else EKF
    for name, own in (("honest", honest), ("sabotaged", cls)):
        register_estimator(name, own)
    CHECKS[law]("honest")
    with pytest.raises((AssertionError, KeyError, TypeError, np.linalg.LinAlgError)):
        CHECKS[law]("sabotaged")


def test_every_clause_has_an_estimator_that_breaks_it():
    numbers = re.findall(r"^ +(\d+)\. ", f"{Estimator.__doc__}{Filter.__doc__}{Smoother.__doc__}", re.MULTILINE)
    # That of poses that are taken out has tests of its own, for the one smoother.
    assert {clause for clause, _, _ in BROKEN} == {int(number) for number in numbers} - {16}


def test_laws_of_walls_are_skipped_with_the_reason_for_an_estimator_of_points():
    verdicts = check_estimator(PointsOnly)
    of_walls = [law.name for law in LAWS if law.needs_walls]
    assert verdicts.kept and list(verdicts.skipped) == of_walls and len(verdicts) == len(LAWS) - len(of_walls)
    reason = "NotImplementedError: walls are not supported"
    assert repr(verdicts) == f"keeps all {len(verdicts)} laws; {len(of_walls)} laws of walls not tested: {reason}"


def test_another_error_for_a_wall_is_no_refusal():
    verdicts = check_estimator(TypeErrorForWalls)
    assert not verdicts.skipped and all(verdicts[law.name] for law in LAWS if law.needs_walls)
