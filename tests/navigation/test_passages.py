"""Ways without clearance: where there is one, which cells it opens, and when it is closed again."""

import numpy as np
import pytest
from test_exploration_states import START, Stage, rectangle

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.passages import Passages
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.mapping.freespace import Bools

BEHIND = UnseenPlace(4.15, 0.3, 0.1, "cut off by inflation only")
"""beside the door, in the room behind it, hidden from the first room"""
NARROW = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.26]], [[4.0, 1.76], [4.0, 3.0]]])
CLOSED = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 3.0]]])


def opened(walls: Array = NARROW, guarded: bool = True) -> tuple[Stage, Passages, Bools | None]:
    stage = Stage(walls)
    for x, y in ((2.0, 1.5), (3.0, 1.0), (3.0, 2.0), (1.5, 2.5)):
        stage.see(Pose(x, y, 0.0))
    stage.look(START)
    passages = Passages(stage.config.grid.clearance_m, guarded)
    planner = stage.exploration._make_view_planner(START)
    return stage, passages, passages.open_to(planner, BEHIND, stage.grid)


def blocked_at_door(stage: Stage, passages: Passages) -> bool:
    """Whether no row of cells is free across the wall."""
    space = stage.grid.free_space()
    blocked = space.blocked.copy()
    passages.unblock(blocked, space, stage.grid)
    (left, right), (low, high) = (
        np.floor((np.array(span) - space.origin[k]) / space.cell_m).astype(int)
        for k, span in enumerate([(3.85, 4.15), (0.3, 2.7)])
    )
    return bool(blocked[low:high, left:right].any(axis=1).all())


def test_a_passage_opens_the_cells_through_the_gap_and_shows_the_place() -> None:
    stage, passages, shown = opened()
    assert shown is not None and shown.any()
    window = stage.exploration._window
    assert shown[window.cell(np.array([BEHIND.x, BEHIND.y]))]
    assert blocked_at_door(stage, Passages(stage.config.grid.clearance_m, True))
    assert not blocked_at_door(stage, passages)


@pytest.mark.parametrize(("walls", "guarded"), [(CLOSED, True), (NARROW, False)])
def test_there_is_no_passage_through_a_wall_or_without_the_guard(walls: Array, guarded: bool) -> None:
    stage, passages, shown = opened(walls, guarded)
    assert shown is None and blocked_at_door(stage, passages)


def test_a_passage_that_the_robot_has_not_come_through_is_closed_for_good() -> None:
    stage, passages, _ = opened()
    passages.moved(START.position)
    passages.close_untried()
    assert blocked_at_door(stage, passages)
    assert passages.open_to(stage.exploration._make_view_planner(START), BEHIND, stage.grid) is None


def test_a_passage_that_the_robot_has_come_through_stays_open() -> None:
    stage, passages, _ = opened()
    passages.moved(np.array([4.3, 1.4]))
    passages.close_untried()
    assert not blocked_at_door(stage, passages)


def test_no_passage_leads_over_obstacle_cells() -> None:
    """What is found in the way after the passage was opened stays blocked."""
    stage, passages, _ = opened()
    stage.walls = np.array([*NARROW.tolist(), [[4.0, 1.26], [4.0, 1.76]]])
    for _ in range(3):
        stage.see(START)
    assert blocked_at_door(stage, passages)
