"""When a loop closure is due."""

import numpy as np

from sixthsense.config import ExploreConfig
from sixthsense.core.geometry import Pose
from sixthsense.navigation.pose_history import PoseHistory


def history(*sigmas_m: float) -> PoseHistory:
    made = PoseHistory(ExploreConfig(loop_closure_sigma_m=0.1))
    for k, sigma_m in enumerate(sigmas_m):
        made.add(Pose(float(k), 0.0, 0.0), np.diag([sigma_m**2, 0.0, 0.0]))
    return made


def test_the_robot_goes_back_to_where_it_was_twice_as_certain() -> None:
    made = history(0.02, 0.05, 0.07, 0.12)
    assert made.needs_loop_closure and not made.is_certain
    np.testing.assert_array_equal(made.well_known_places(), [[0.0, 0.0], [1.0, 0.0]])


def test_a_place_that_is_always_as_uncertain_is_left_for_one_loop_closure_only() -> None:
    made = history(0.02, 0.12)
    made.postpone_loop_closure()
    for _ in range(3):
        for sigma_m in (0.02, 0.12, 0.17):
            made.add(Pose(), np.diag([sigma_m**2, 0.0, 0.0]))
            assert not made.needs_loop_closure
    made.add(Pose(), np.diag([0.19**2, 0.0, 0.0]))
    assert made.needs_loop_closure


def test_a_robot_that_may_soon_be_lost_goes_back_every_time() -> None:
    made = history(0.02, 0.4)
    for _ in range(3):
        made.add(Pose(), np.diag([0.41**2, 0.0, 0.0]))
        assert made.needs_loop_closure
        made.postpone_loop_closure()
