"""When a loop closure is due."""

import numpy as np
import pytest

from sixthsense.config import ExploreConfig
from sixthsense.core.geometry import Pose
from sixthsense.navigation.pose_history import PoseHistory


def history(*sigmas_m: float) -> PoseHistory:
    made = PoseHistory(ExploreConfig())
    for k, sigma_m in enumerate(sigmas_m):
        made.add(Pose(float(k), 0.0, 0.0), np.diag([sigma_m**2, 0.0, 0.0]), True)
    return made


def test_the_robot_goes_back_to_where_it_was_twice_as_certain() -> None:
    made = history(0.02, 0.05, 0.07, 0.12)
    assert made.needs_loop_closure and not made.is_certain
    np.testing.assert_array_equal(made.well_known_places(), [[0.0, 0.0, 0.02, 3.0], [1.0, 0.0, 0.05, 2.0]])


def test_a_return_is_worth_a_way_that_is_short_beside_the_one_driven_since() -> None:
    """From .2 m after 3 m to .1 m or less: .02² + (.2² - .02²) s = .1² at s = .2424."""
    made = history(0.02, 0.12, 0.15, 0.2)
    places = made.well_known_places()
    for share, is_worth_it in ((0.24, True), (0.25, False), (1.0, False), (np.inf, False)):
        assert made.are_worth_it(places, np.array([3.0 * share])).tolist() == [is_worth_it]


def test_nothing_draws_the_robot_to_where_it_saw_no_wall() -> None:
    made = history()
    made.add(Pose(), np.diag([0.01**2, 0.0, 0.0]), False)
    made.add(Pose(1.0, 0.5, 0.3), np.diag([0.2**2, 0.0, 0.0]), True)
    assert made.needs_loop_closure and len(made.well_known_places()) == 0


def test_a_place_that_is_always_as_uncertain_is_left_for_one_loop_closure_only() -> None:
    made = history(0.02, 0.12)
    made.postpone_loop_closure()
    for _ in range(3):
        for sigma_m in (0.02, 0.12, 0.23):
            made.add(Pose(), np.diag([sigma_m**2, 0.0, 0.0]), True)
            assert not made.needs_loop_closure
    made.add(Pose(), np.diag([0.25**2, 0.0, 0.0]), True)
    assert made.needs_loop_closure


@pytest.mark.parametrize(("sigma_m", "known"), [(0.2, [0.02]), (0.03, [])])
def test_a_return_that_does_not_help_is_made_again_only_to_places_known_much_better(
    sigma_m: float, known: list[float]
) -> None:
    made = history(0.02, 0.05, 0.09, 0.2)
    made.go_back(made.well_known_places()[2])
    made.add(Pose(2.0, 0.1, 0.3), np.diag([sigma_m**2, 0.0, 0.0]), True)
    made.came_back()
    assert made.well_known_places()[:, 2].tolist() == known
    made.add(Pose(7.0, 0.0, 0.0), np.diag([0.2**2, 0.0, 0.0]), True)
    assert made.well_known_places()[:, 2].tolist() == (known or [0.02, 0.05, 0.09, sigma_m])


def test_a_robot_that_may_soon_be_lost_goes_back_every_time() -> None:
    made = history(0.02, 0.4)
    for _ in range(3):
        made.add(Pose(), np.diag([0.41**2, 0.0, 0.0]), True)
        assert made.needs_loop_closure
        made.postpone_loop_closure()
