"""Observations that name their landmark: misread names, landmarks in wrong places and robots that were pushed."""

import numpy as np
import pytest
from predicted import predict_points

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator

POINTS = {3: (3.1, 1.2), 5: (2.4, -1.7), 8: (4.6, 0.3), 9: (5.2, 2.9), 12: (6.0, -2.2)}
START, SIGMA = Pose(0.4, -0.3, 0.2), 0.05
CONFIG = AssociationConfig(known_probability=0.999999, cull_below=0)


class Drive:
    """A robot that looks at landmarks, and what it believes."""

    def __init__(self, name: str, probability: float = CONFIG.known_probability) -> None:
        self.estimator = make_estimator(name, START, np.zeros((3, 3)))
        config = AssociationConfig(known_probability=probability, cull_below=0)
        self.associator, self.rng = Associator(config), np.random.default_rng(4)

    def look(self, true: Pose, ids: dict[int, int]):
        """One keyframe from a true pose: names, and the landmarks that they are read of."""
        z, _, _ = predict_points(true, np.array([POINTS[i] for i in ids.values()]))
        z = z + SIGMA * self.rng.standard_normal(z.shape)
        seen = {i: Observation(Kind.CORNER, row, SIGMA**2 * np.eye(2)) for i, row in zip(ids, z, strict=True)}
        found = self.associator.match_named(seen, self.estimator)
        if found.slip is not None:
            self.estimator.predict(found.slip)
        self.estimator.update(found.observations)
        self.estimator.forget(self.associator.forgotten(self.estimator, self.estimator.estimate()))
        return found

    def place(self, i: int):
        estimate = self.estimator.estimate()
        return estimate.landmarks[estimate.ids.tolist().index(i)]

    def is_at(self, true: Pose, within_m: float = 0.15, within_rad: float = 0.05) -> bool:
        off = true.inverse() @ self.estimator.estimate().pose
        return bool(np.hypot(off.x, off.y) < within_m and abs(off.theta) < within_rad)


def that_knows_all(name: str = "ekf-invariant", probability: float = CONFIG.known_probability) -> Drive:
    drive = Drive(name, probability)
    for _ in range(6):
        drive.look(START, {i: i for i in POINTS})
    return drive


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_a_landmark_that_was_misread_at_its_first_look_is_put_where_later_looks_see_it(name):
    drive = Drive(name)
    drive.look(START, {3: 3, 5: 5, 8: 12})
    assert np.hypot(*(drive.place(8) - POINTS[8])) > 2.0
    for _ in range(5):
        drive.look(START, {3: 3, 8: 8})
    assert np.hypot(*(drive.place(8) - POINTS[8])) < 0.15 and drive.associator.culled == 1
    assert drive.associator.records[8].observations == 3


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_a_robot_that_was_pushed_is_found_by_two_landmarks_that_contradict_the_map_alike(name):
    drive, pushed = that_knows_all(name), START @ Pose(-0.5, 0.4, 0.6)
    assert drive.look(pushed, {9: 9}).slip is None and drive.is_at(START)
    found = drive.look(pushed, {12: 12})
    assert found.slip is not None and set(found.observations) == {12}
    drive.look(pushed, {9: 9, 3: 3})
    assert drive.is_at(pushed)
    assert all(np.hypot(*(drive.place(i) - place)) < 0.1 for i, place in POINTS.items())


def test_a_name_that_is_misread_in_every_picture_moves_neither_robot_nor_landmark():
    drive = that_knows_all()
    before = drive.estimator.estimate()
    for _ in range(5):
        assert drive.look(START, {9: 5}).discarded == 1
    after = drive.estimator.estimate()
    assert after.pose == before.pose and np.array_equal(after.landmarks, before.landmarks)
    drive.look(START, {3: 3})
    assert drive.associator.culled == 0


def test_two_misread_names_that_do_not_fit_each_other_are_no_push():
    drive = that_knows_all()
    assert all(drive.look(START, seen).slip is None for seen in ({9: 5}, {12: 8}))
    assert drive.is_at(START)


def test_a_robot_in_doubt_puts_nothing_new_into_the_map():
    drive, far = Drive("ekf-invariant"), START @ Pose(4.5, -2.5, 2.9)
    for _ in range(4):
        drive.look(START, {i: i for i in (3, 5, 9)})
    found = drive.look(far, {3: 3, 9: 9, 8: 8})  # too far for a push
    assert found.slip is None and found.discarded == 3 and 8 not in drive.associator.records


def test_without_a_gate_no_look_contradicts_the_map():
    drive = that_knows_all(probability=1.0)
    found = drive.look(START, {9: 5, 12: 12})
    assert found.discarded == 0 and found.slip is None
