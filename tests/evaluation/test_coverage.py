import itertools
import math

import numpy as np
import pytest
from scanned import box

from sixthsense.core.geometry import Array
from sixthsense.core.ray_casting import beams_of
from sixthsense.evaluation.coverage import VisibleArea, _mark, coverage, visible_area

CIRCLE = np.arange(360) * (2 * math.pi / 360)


def segments(*walls) -> Array:
    return np.array(walls, dtype=np.float64).reshape(-1, 2, 2)


def at(area: VisibleArea, x: float, y: float) -> bool:
    return bool(area.mask[int((y - area.origin[1]) / area.cell_m), int((x - area.origin[0]) / area.cell_m)])


ROOM = segments(*box(0, 0, 6, 4))
DOOR_M = 0.8
TWO_ROOMS = segments(*box(0, 0, 6, 4), [(3, 0), (3, 2)], [(3, 2 + DOOR_M), (3, 4)])


def test_a_room_behind_a_wall_does_not_count() -> None:
    walls = segments(*box(0, 0, 6, 4), [(4, 0), (4, 4)])
    area = visible_area(walls, (0, 0, 6, 4), (1, 1), 0.2, 20.0)
    assert area.square_metres == pytest.approx((4 - 0.1) * (4 - 0.1), rel=0.01)
    assert not at(area, 5, 2)
    assert coverage(area, np.array([[3.0, 2.0, 0.0]]), CIRCLE, 20.0, walls) == [1.0]


def test_a_robot_sees_through_glass_and_goes_no_way_through_it() -> None:
    walls = segments(*box(0.3, 0.2, 6.0, 4.0), [(4.6, 0.2), (4.6, 3.4)])
    glass = segments([(3.4, 0.2), (3.4, 4.2)])
    whole = (0.3, 0.2, 6.3, 4.2), (1.2, 0.9), 0.25, 20.0
    area = visible_area(walls, *whole, glass=glass)
    # From the left of the glass no line leads around the wall's end to a place close behind the wall.
    assert at(area, 3.9, 2.2) and at(area, 5.9, 4.0) and not at(area, 4.8, 0.7)
    assert at(visible_area(walls, *whole), 4.8, 0.7)
    assert not at(visible_area(np.concatenate([walls, glass]), *whole), 3.9, 2.2)


def crossed_cells(x: float, y: float, end_x: float, end_y: float) -> set[tuple[int, int]]:
    """The cells in which the pieces lie that the grid's lines cut a segment into."""
    cuts = [0.0, 1.0]
    for start, end in ((x, end_x), (y, end_y)):
        lines = range(math.floor(min(start, end)), math.ceil(max(start, end)) + 1)
        cuts += [(line - start) / (end - start) for line in lines if end != start]
    cuts = sorted(t for t in cuts if 0.0 <= t <= 1.0)
    middles = [0.5 * (a + b) for a, b in itertools.pairwise(cuts) if b - a > 1e-12]
    return {(math.floor(y + t * (end_y - y)), math.floor(x + t * (end_x - x))) for t in middles}


def test_a_beam_marks_exactly_the_cells_it_crosses() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-3, 13, 2)
        angle = rng.uniform(-math.pi, math.pi) if seed % 3 else (seed % 4) * math.pi / 2
        length = rng.uniform(0.0, 15.0)
        cos, sin = np.round([math.cos(angle), math.sin(angle)], 15)
        first = np.full((10, 8), -1, dtype=np.int32)
        first[4] = 3  # the row was seen before
        beam = beams_of(np.array([angle]))._replace(cos=np.array([cos]), sin=np.array([sin]))
        _mark((x, y, 0.0), beam, np.array([length]), 5, first)
        expected = crossed_cells(x, y, x + length * cos, y + length * sin)
        inside = {(r, c) for r, c in expected if 0 <= r < 10 and 0 <= c < 8}
        assert {(int(r), int(c)) for r, c in np.argwhere(first == 5)} == {cell for cell in inside if cell[0] != 4}
        assert (first[4] == 3).all()
