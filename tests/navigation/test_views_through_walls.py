"""Holes in walls are no views: neither is anything sought behind them, nor is it left."""

import numpy as np
import pytest
from scipy import ndimage

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.navigation import view_planner
from sixthsense.navigation.gridsearch import costs_from
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.regions import frontier_cells
from sixthsense.navigation.tour import TileWays
from sixthsense.navigation.unseen_places import UnseenPlace, unseen_places
from sixthsense.navigation.view_planner import Target, ViewPlanner
from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.navigation.views import KnownViews, SensorModel, ViewGain
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.inflation import too_near

CELL_M, RADIUS_M, CLEARANCE_M = 0.05, 0.2, 0.1
SHAPE = 60, 120
FRAME = 64, 128
HERE = 30, 20
REGION = (0.1, 0.1, 5.9, 2.9)


def planner(opening: int, behind: Bools | None = None, tries: int = 0, screen: bool = False) -> ViewPlanner:
    """A seen room to the left of column 60, where a wall has an `opening` of so many cells, and unseen cells behind.

    `behind` (H, W) are cells behind the wall that were seen; `tries` how often the unseen ones were looked at;
    a `screen` stands behind the opening.
    """
    obstacles = np.zeros(SHAPE, dtype=np.bool_)
    obstacles[[2, -3], 2:118] = True
    obstacles[2:58, [2, 60, 117]] = True
    obstacles[30 - opening // 2 : 30 - opening // 2 + opening, 60] = False
    obstacles[18:43, 70] |= screen
    seen = np.zeros(SHAPE, dtype=np.bool_)
    seen[3:57, 3:61] = True
    if behind is not None:
        seen |= behind
    config = preset("default", grid={"cell_m": CELL_M})
    view = MapView(REGION, RADIUS_M, config)
    view._make_masks(Box(0, 0, *FRAME))
    height, width = SHAPE
    seen |= obstacles
    view.seen[:height, :width], view.obstacles[:height, :width] = seen, obstacles
    view.blocked[:] = too_near(view.obstacles, (RADIUS_M + CLEARANCE_M) / CELL_M)
    view.opaque[:] = ndimage.binary_dilation(view.obstacles, np.ones((5, 5), dtype=np.bool_))
    view.free[:] = view.seen & ~view.obstacles
    view.edge = np.argwhere(frontier_cells(view.free, ~view.seen))
    view._attempts[view.unseen] = tries
    solid = view.obstacles.astype(np.int32)
    view.grid = Grid.from_counts(config.grid, RADIUS_M, (0.0, 0.0), solid, 0 * solid, view.seen)
    view.wanted[:] = view.unseen & (tries < 2)
    reachable = costs_from((view.seen & ~view.blocked).astype(np.uint8), *HERE) >= 0
    ways = TileWays(8)
    ways.update(reachable)
    gain, pose = ViewGain(view, SensorModel(180, 100.0, 40.0, 1.0)), Pose(*view.point(*HERE), 0.0)
    viewpoints = Viewpoints(reachable, view.obstacles, 100.0)
    return ViewPlanner(gain, pose, reachable, viewpoints, ways, config, pose.position, KnownViews())


def next_target(view: ViewPlanner) -> Target | None:
    candidates = view.candidates()
    return view.best(candidates) if candidates.clusters else None


def left_by(view: ViewPlanner) -> list[UnseenPlace]:
    return unseen_places(view, view.candidates())


def room_behind() -> Bools:
    """(H, W) most of a room behind the wall, glimpsed, but not its corners beside the wall."""
    rows, cols = np.indices(SHAPE)
    return (cols > 60) & (cols < 117) & (abs(rows - 30) <= (cols - 58)) & (rows > 2) & (rows < 57)


@pytest.mark.parametrize("opening", [1, 2, 3, 4])
def test_a_hole_in_a_wall_is_no_view_and_nothing_is_left_behind_it(opening: int) -> None:
    assert planner(opening).candidates().clusters
    assert next_target(planner(opening)) is None
    assert left_by(planner(opening, tries=2)) == []


@pytest.mark.parametrize("opening", [8, 20])
def test_an_opening_is_a_view(opening: int) -> None:
    target = next_target(planner(opening))
    assert target is not None
    assert (abs(target.cells - np.array([30, 61])) <= opening).all()
    left = left_by(planner(opening, tries=2))
    assert left[0].reason == "gave up" and left[0].x > 60 * CELL_M


def test_what_is_beside_single_beams_is_to_be_seen_where_what_is_between_them_connects_them() -> None:
    """Beams end behind an opening, too far apart for their cells to share edges."""
    made = planner(20)
    view, beams = made.view, np.zeros(FRAME, dtype=np.bool_)
    beams[22:38:3, 61:70:2] = True
    view.wanted[:, :70] = False
    view.free |= beams
    view.filled[:] = view.free
    view.filled[22:38, 61:70] = True
    view.edge = np.argwhere(frontier_cells(view.free, view.wanted))
    assert len(view.edge) == 6
    assert made.candidates().clusters == []
    assert sum(len(cells) for cells in made.candidates(view.filled).clusters) == 6


def test_what_all_views_show_together_is_ignored_if_it_is_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The unseen region behind the wall is as large as the room before it, which shows a tenth of it."""
    monkeypatch.setattr(view_planner, "IGNORED_AREA_FRACTION", 0.03)
    assert next_target(planner(8)) is not None
    monkeypatch.setattr(view_planner, "IGNORED_AREA_FRACTION", 0.5)
    assert planner(8).candidates().clusters
    assert next_target(planner(8)) is None


def test_what_only_a_robot_without_clearance_would_see_is_looked_at_past_the_edge_and_then_left() -> None:
    """The robot fits through an opening of 10 cells without its clearance only."""
    view = planner(10, room_behind())
    target = next_target(view)
    assert target is not None
    left = left_by(planner(10, room_behind(), tries=2))
    assert {place.reason for place in left} == {"cut off by inflation only"}
    assert sum(place.area_m2 for place in left) > 0.3


def test_a_room_that_was_glimpsed_through_a_gap_too_narrow_for_the_robot_is_unreachable() -> None:
    left = left_by(planner(5, room_behind(), tries=2))
    assert {place.reason for place in left} == {"unreachable"}
    assert all(place.gap_m == pytest.approx(6 * CELL_M, abs=0.02) for place in left)  # between the centres of cells
