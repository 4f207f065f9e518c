"""The laws of every estimator; a new one is tested by its name in ESTIMATORS."""

import numpy as np
import pytest
from laws import links, parameters, prior_map
from point_world import make

from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import ESTIMATORS, Filter, Link, Smoother
from sixthsense.testing.estimators import LAWS

FILTERS = [name for name in ESTIMATORS if isinstance(make(name), Filter)]
SMOOTHERS = [name for name in ESTIMATORS if isinstance(make(name), Smoother)]
OF_FILTERS = [*parameters.LAWS, *parameters.WALLS, *prior_map.LAWS]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_keeps_the_law(name, law):
    law.check(name)


@pytest.mark.parametrize("law", OF_FILTERS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", FILTERS)
def test_filters_keep_the_laws(name, law):
    law.check(name)


@pytest.mark.parametrize("law", links.LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", SMOOTHERS)
def test_links_keep_the_laws(name, law):
    law.check(name)


@pytest.mark.parametrize("name", SMOOTHERS)
def test_a_link_says_nothing_of_a_direction_that_it_has_not_observed(name):
    """As along a corridor: millimetres across, and a kilometre along."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        smoother = make(name, Pose(), 1e-12 * np.eye(3))
        smoother.update({})
        smoother.predict(Odometry(Pose(1.0, 0.2, 0.3), 0.01**2 * np.eye(3)))
        smoother.update({})
        before = smoother.estimate().pose_cov
        link = Odometry(Pose(1.01, 0.2, 0.3), (axes * np.array([0.003, 0.008, 1000.0]) ** 2) @ axes.T)
        smoother.link([Link(0, 1, link)])
        unseen = Pose(theta=smoother.estimate().pose.theta).adjoint() @ axes[:, 2]  # world axes
        along = [unseen @ np.linalg.inv(cov) @ unseen for cov in (before, smoother.estimate().pose_cov)]
        assert along[1] == pytest.approx(along[0], rel=0.05)


def test_a_shipped_estimator_is_a_filter_or_a_smoother():
    assert FILTERS == ["ekf", "ekf-invariant"] and SMOOTHERS == ["isam2"]
