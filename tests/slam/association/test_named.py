"""Observations that name their landmark: misread names, and landmarks in wrong places."""

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
        self.estimator.update(found.observations)
        self.estimator.forget(self.associator.forgotten(self.estimator, self.estimator.estimate()))
        return found

    def place(self, i: int):
        estimate = self.estimator.estimate()
        return estimate.landmarks[estimate.ids.tolist().index(i)]


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


def test_a_name_that_is_misread_in_every_picture_moves_neither_robot_nor_landmark():
    drive = that_knows_all()
    before = drive.estimator.estimate()
    for _ in range(4):
        assert drive.look(START, {9: 5}).discarded == 1
    after = drive.estimator.estimate()
    assert after.pose == before.pose and np.array_equal(after.landmarks, before.landmarks)
    drive.look(START, {3: 3})
    assert drive.associator.culled == 0


def test_a_landmark_without_a_name_gets_an_id_that_no_name_has():
    drive = Drive("ekf-invariant")
    drive.look(START, {0: 3, 4: 5})
    found = drive.associator.associate(
        [Observation(Kind.CORNER, np.array([-3.0, 2.0]), SIGMA**2 * np.eye(2))], drive.estimator
    )
    assert list(found.observations) == [5] and sorted(drive.associator.records) == [0, 4, 5]
