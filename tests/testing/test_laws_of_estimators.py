"""The laws of estimators find errors: wrong covariances of observations, wrong Jacobians, lost correlations, no
walls."""

import dataclasses

import numpy as np
import pytest
from laws import links

from sixthsense.slam.estimators import ekf, ekf_algebra, register_estimator
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing import check_estimator
from sixthsense.testing.check import LAWS
from sixthsense.testing.estimation import CONVERGED

CHECKS = {law.name: law.check for law in LAWS}

INITIALIZED = "new_landmarks_have_the_joint_covariance_of_batch_least_squares [{}]"
UPDATED = "the_first_update_gives_the_posterior_of_batch_least_squares [{}]"
DRIVEN = "a_drive_gives_the_posterior_of_batch_least_squares [{}]"
ADDED = "an_update_adds_the_information_of_its_observations [{}]"
TWICE = "two_updates_with_one_observation_equal_one_with_half_its_covariance [{}]"
ORDER = "the_order_of_two_updates_makes_no_difference [{}]"
KINDS = ("points", "walls")


def breaks(cls, law):
    """Whether an estimator violates the law, or fails numerically on the way, as with an indefinite covariance."""
    register_estimator("sabotaged", cls)
    try:
        CHECKS[law]("sabotaged")
    except (AssertionError, np.linalg.LinAlgError):
        return True
    return False


def is_of(kind, observation):
    return observation.is_wall == (kind == "walls")


def with_scaled_covariance(kind, factor, only_known):
    """Uses the observations of one kind with `factor` times their covariance, in updates or at initialization too."""

    class Sabotaged(EKF):
        def update(self, observations):
            wrong = {
                i: dataclasses.replace(s, cov=factor * s.cov)
                for i, s in observations.items()
                if is_of(kind, s) and (i in self._slots or not only_known)
            }
            super().update({**observations, **wrong})

    return Sabotaged


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [UPDATED, DRIVEN, ADDED])
def test_an_update_with_a_quarter_of_the_covariance_is_found(kind, law):
    sabotaged = with_scaled_covariance(kind, 0.25, only_known=True)
    assert breaks(sabotaged, law.format(kind)) and breaks(sabotaged, law.format("points and walls"))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_an_initialization_with_another_covariance_is_found(kind, factor):
    assert breaks(with_scaled_covariance(kind, factor, only_known=False), INITIALIZED.format(kind))


def with_wrong_jacobian(name, kind, change):
    """Takes a Jacobian of the `expected` observations or of `initialize_landmark`, changed by `change`."""
    module = ekf if name == "expected" else ekf_algebra
    honest = getattr(module, name)

    def wrong_prediction(pose, means, point, anchors, walls, centres):
        z, by_pose, by_landmark = honest(pose, means, point, anchors, walls, centres)
        for k in np.flatnonzero(walls == (kind == "walls")):
            change(by_pose[k], by_landmark[k])
        return z, by_pose, by_landmark

    def wrong_initialization(pose, observation):
        mean, by_pose, by_z = honest(pose, observation)
        if is_of(kind, observation):
            change(by_pose, by_z)
        return mean, by_pose, by_z

    class Sabotaged(EKF):
        def update(self, observations):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(module, name, wrong_prediction if name == "expected" else wrong_initialization)
                super().update(observations)

    return Sabotaged


def times(factor, matrix, *entry):
    """Multiplies one entry of the Jacobian by the pose (0) or by the landmark or observation (1)."""

    def change(*jacobians):
        jacobians[matrix][entry] *= factor

    return change


PREDICTION_ENTRIES = [
    *(("walls", entry) for entry in ((0, 0, 2), (0, 1, 0), (0, 1, 1), (1, 0, 0), (1, 1, 0), (1, 1, 1))),
    *(("points", entry) for entry in ((0, 0, 0), (0, 1, 1), (0, 0, 2), (0, 1, 2), (1, 0, 1), (1, 1, 1))),
]
INITIALIZATION_ENTRIES = [
    *(("walls", entry) for entry in ((0, 0, 2), (0, 1, 0), (0, 1, 1), (0, 1, 2), (1, 0, 0), (1, 1, 0), (1, 1, 1))),
    *(("points", entry) for entry in ((0, 0, 0), (0, 1, 1), (0, 0, 2), (0, 1, 2), (1, 0, 0), (1, 0, 1), (1, 1, 1))),
]
"""kind, matrix (0 by the pose, 1 by the landmark or observation), row, column"""


@pytest.mark.parametrize(("kind", "entry"), PREDICTION_ENTRIES)
def test_an_entry_of_an_observations_jacobian_that_is_half_is_found(kind, entry):
    sabotaged = with_wrong_jacobian("expected", kind, times(0.5, *entry))
    other = KINDS[kind == "points"]
    assert breaks(sabotaged, DRIVEN.format(kind)) and breaks(sabotaged, ADDED.format(kind))
    assert not breaks(sabotaged, DRIVEN.format(other))


@pytest.mark.parametrize(("kind", "entry"), INITIALIZATION_ENTRIES)
def test_an_entry_of_an_initializations_jacobian_that_is_half_is_found(kind, entry):
    sabotaged = with_wrong_jacobian("initialize_landmark", kind, times(0.5, *entry))
    assert breaks(sabotaged, INITIALIZED.format(kind))


def without_correlations(part, factor, when):
    """Multiplies the correlations of pose and landmarks, or between landmarks, after updates or at initialization."""

    class Sabotaged(EKF):
        def _scale(self):
            if part == "pose and landmarks":
                self._cov[3:, :3] *= factor
                return
            for k in range(len(self._means)):
                self._cov[5 + 2 * k :, 3 + 2 * k : 5 + 2 * k] *= factor

        def _apply_correction(self, slots, shift):
            super()._apply_correction(slots, shift)
            if when == "update":
                self._scale()

        def _augment(self, observations):
            super()._augment(observations)
            if observations and when == "initialization":
                self._scale()

    return Sabotaged


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", ["pose and landmarks", "landmarks"])
@pytest.mark.parametrize(("when", "law"), [("update", UPDATED), ("update", ADDED), ("initialization", INITIALIZED)])
def test_halved_correlations_are_found(part, when, law, kind):
    assert breaks(without_correlations(part, 0.5, when), law.format(kind))


class CountsTwice(EKF):
    """Uses the evidence of an update's observations a second time, if they are of a landmark of the update before."""

    last = ()

    def update(self, observations):
        super().update(observations)
        repeated = {i: s for i, s in observations.items() if i in self.last}
        self.last = tuple(observations)
        if repeated:
            super().update(repeated)
            del self._trajectory[-3:]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [ORDER, DRIVEN, ADDED])
def test_evidence_that_counts_twice_is_found(kind, law):
    assert breaks(CountsTwice, law.format(kind))


class NoiseFloor(EKF):
    """Adds a variance to that of each observation."""

    def update(self, observations):
        floor = 2.5e-8 * np.eye(2)
        super().update({i: dataclasses.replace(s, cov=s.cov + floor) for i, s in observations.items()})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [INITIALIZED, UPDATED, TWICE])
def test_a_floor_of_the_noise_is_found(kind, law):
    assert breaks(NoiseFloor, law.format(kind))


class WorldOffsets(EKF):
    """Returns the offset of a wall without the effect of its angle on the way from the start to the world's origin."""

    def joint_covariance(self, ids):
        self._propagate()
        slots = np.array([self._slots[i] for i in ids], dtype=np.int64)
        return self._symmetric(self._pose_and_landmarks(slots))


class UnwrappedInnovation(EKF):
    def _correct(self, slots, observations):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(ekf, "observation_innovations", lambda z, cov, predicted, walls: (z - predicted, cov))
            return super()._correct(slots, observations)


class UnflaggedWalls(EKF):
    def estimate(self):
        estimate = super().estimate()
        return dataclasses.replace(estimate, walls=np.zeros_like(estimate.walls))


@pytest.mark.parametrize(
    ("cls", "law"),
    [
        (WorldOffsets, INITIALIZED.format("walls")),
        (WorldOffsets, "moving_the_world_moves_walls_with_it [1]"),
        (WorldOffsets, "a_new_wall_is_initialized_from_its_observation"),
        (UnwrappedInnovation, "the_innovation_of_a_wall_is_wrapped"),
        (UnflaggedWalls, "a_wall_is_returned_as_a_wall"),
    ],
)
def test_an_error_with_walls_is_found(cls, law):
    assert breaks(cls, law)


class PointsOnly(EKF):
    """Refuses walls as the contract says."""

    def update(self, observations):
        if any(observation.is_wall for observation in observations.values()):
            raise NotImplementedError("walls are not supported")
        super().update(observations)


class LateRefusal(PointsOnly):
    """Refuses walls after the points of the same scan were used."""

    def update(self, observations):
        EKF.update(self, {i: observation for i, observation in observations.items() if not observation.is_wall})
        super().update({i: observation for i, observation in observations.items() if observation.is_wall})


class TypeErrorForWalls(EKF):
    def update(self, observations):
        if any(observation.is_wall for observation in observations.values()):
            raise TypeError("found a wall")
        super().update(observations)


def test_laws_of_walls_are_skipped_with_the_reason_for_an_estimator_of_points():
    verdicts = check_estimator(PointsOnly)
    of_walls = [law.name for law in LAWS if law.needs_walls]
    assert verdicts.kept and list(verdicts.skipped) == of_walls and len(verdicts) == len(LAWS) - len(of_walls)
    assert DRIVEN.format("points") in verdicts and DRIVEN.format("walls") in verdicts.skipped
    reason = "NotImplementedError: walls are not supported"
    assert repr(verdicts) == f"keeps all {len(verdicts)} laws; {len(of_walls)} laws of walls not tested: {reason}"
    assert verdicts._repr_html_().count("not tested") == len(of_walls)


def test_a_refusal_that_has_changed_the_state_is_found():
    assert breaks(LateRefusal, "a_scan_with_a_wall_is_used_or_refused_as_a_whole")
    assert not breaks(PointsOnly, "a_scan_with_a_wall_is_used_or_refused_as_a_whole")


def test_another_error_for_a_wall_is_no_refusal():
    verdicts = check_estimator(TypeErrorForWalls)
    assert not verdicts.skipped and all(verdicts[law.name] for law in LAWS if law.needs_walls)


def test_an_honest_estimator_keeps_the_laws_of_the_posterior():
    assert not any(breaks(EKF, law.format(kind)) for law in (INITIALIZED, DRIVEN, ADDED, TWICE) for kind in KINDS)


class KeepsLinks(ISAM2):
    """Keeps the links that it should remove."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def unlink(self, ids):
        for i in ids:
            del self._links[i]


class SureOfLinks(ISAM2):
    """Takes links as twice as certain as they are."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def link(self, links):
        sure = [
            dataclasses.replace(k, relative=dataclasses.replace(k.relative, cov=0.25 * k.relative.cov)) for k in links
        ]
        return super().link(sure)


@pytest.mark.parametrize(
    ("cls", "broken"),
    [(KeepsLinks, "removed_links_leave_no_trace"), (SureOfLinks, "links_give_the_least_squares_solution")],
)
def test_links_that_stay_and_links_of_another_weight_are_found(cls, broken):
    register_estimator("sabotaged-links", cls)
    law = next(law for law in links.LAWS if law.name == broken)
    with pytest.raises(AssertionError):
        law.check("sabotaged-links")
