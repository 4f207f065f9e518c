"""The area that an exploration is to see, and how far outside it the robot may drive."""

import math

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.navigation.exploration_task import AreaToSee
from sixthsense.slam.mapping.changes import Box

REGION, CELL_M = (-1.23, -0.72, 2.31, 1.88), 0.07
CONFIG = preset(grid={"cell_m": CELL_M}, laser={"max_range": 3.4}, explore={"margin_m": 0.37})


@pytest.mark.parametrize(("is_wide", "margin_m"), [(False, 0.37), (True, 3.4)])
def test_the_robot_drives_within_a_margin_or_as_far_outside_as_its_laser_reaches(
    is_wide: bool, margin_m: float
) -> None:
    area = AreaToSee(REGION, CONFIG)
    area.is_wide = is_wide
    x0, y0, x1, y1 = REGION
    low, high = (
        (math.floor((v - margin_m) / CELL_M) for v in (y0, x0)),
        (math.ceil((v + margin_m) / CELL_M) for v in (y1, x1)),
    )
    assert area.limits == Box(*low, *high)


def test_unknown_cells_beside_those_of_the_region_count_up_to_half_of_the_margin_outside() -> None:
    area = AreaToSee(REGION, CONFIG)
    assert area.narrow_outside == round(0.5 * 0.37 / CELL_M)
    box = Box(-60, -60, 60, 60)
    unknown, attempts = np.ones((120, 120), dtype=np.bool_), np.zeros((120, 120), dtype=np.int64)
    rows, cols = (np.argwhere(area.to_see(unknown, box, attempts)).T + np.array([[box.top], [box.left]])).tolist()
    inside = np.argwhere(area.of_region(unknown, box)) + np.array([box.top, box.left])
    reach = area.narrow_outside
    assert (min(rows), max(cols)) == (inside[:, 0].min() - reach, inside[:, 1].max() + reach)
