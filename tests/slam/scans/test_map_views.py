"""Views of a map of cells."""

import numpy as np
from rooms import HALF, ROOM, ROUND, scan_at

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.se2 import compose
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.scans.links import WIDE_GATE_M, align_pairs
from sixthsense.slam.scans.map_views import MapViews

CELL_M = 0.05


def map_of(walls, *poses):
    """The evidence of scans from poses."""
    rng, grid = np.random.default_rng(0), Grid(GridConfig(cell_m=CELL_M), 0.2)
    for pose in poses:
        grid.add(pose, scan_at(pose, walls, rng=rng), np.zeros((0, 2, 2)))
    return grid.submap()


MAP = map_of(ROOM, *(Pose(x, y, 0.0) for x in (-3.0, 0.0, 3.0) for y in (-2.0, 2.0)))


def seen_from(evidence, pose):
    """The view from a place (x, y), as the rows of its returns: bearing, range."""
    views = MapViews(evidence, GridConfig(cell_m=CELL_M), scan_at(pose))
    (row,) = views.partners(0, pose.array(), 1)
    assert views.poses[row].tolist() == [pose.x, pose.y, 0.0]
    points = views.store.returns.points[row]
    points = points[points[:, 2] > 0.0]
    return np.arctan2(points[:, 1], points[:, 0]), points[:, 2]


def test_a_view_shows_the_walls_to_a_part_of_a_cell():
    pose = Pose(-0.4, 0.3, 0.0)
    bearings, ranges = seen_from(MAP, pose)
    true = cast_rays(pose, bearings, ROOM, ROUND.max_range)
    assert len(ranges) > 0.9 * ROUND.beams
    assert np.median(np.abs(ranges - true)) < 0.3 * CELL_M


def test_a_beam_into_what_was_not_seen_shows_nothing():
    half = map_of(ROOM[:1], Pose(0.0, -2.0, 0.0))  # one wall, along y = -3; nothing is known behind it
    bearings, _ = seen_from(half, Pose(0.0, -2.0, 0.0))
    assert len(bearings) and (bearings < 0.0).all()


def test_a_scan_of_a_half_circle_aligns_with_a_view():
    true, views = Pose(0.7, -1.2, 2.2), MapViews(MAP, GridConfig(cell_m=CELL_M), scan_at(Pose(), laser=HALF))
    scan = views.add(scan_at(true, laser=HALF, rng=np.random.default_rng(1)), Pose(5.0, 5.0, 1.0), 0.0)
    rough = true.array() + np.array([0.1, -0.08, 0.06])
    (target,) = views.partners(scan, rough, 1)
    start = rough - views.poses[target]
    found = align_pairs(views.store.returns, np.array([target]), np.array([scan]), start[None], WIDE_GATE_M)
    off = compose(views.poses[target], found.poses[0]) - true.array()
    assert np.hypot(*off[:2]) < 0.01 and abs(off[2]) < 0.005
    assert found.agree(0.9, 1.0).all()


def test_places_near_each_other_have_one_view():
    views = MapViews(MAP, GridConfig(cell_m=CELL_M), scan_at(Pose()))
    near = [views.partners(0, np.array([0.1 + d, 0.1, 0.0]), 1)[0] for d in (0.0, 0.2, 1.0)]
    assert near[0] == near[1] != near[2]
