"""Alignment of a scan's walls with the map's walls."""

import math

import numpy as np
import pytest

from sixthsense.config import AlignConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation, predict_walls
from sixthsense.slam.association.wall_alignment import _residuals, align
from sixthsense.slam.estimators import Estimate

# A room of 6 m by 4 m with a slanted cupboard, walls by (alpha, d) with normals inwards, and their ends.
CORNERS = np.array([[-3.0, -2.0], [3.0, -2.0], [3.0, 1.0], [1.5, 2.0], [-3.0, 2.0]])


def room(corners=CORNERS):
    following = np.roll(corners, -1, axis=0)
    direction = following - corners
    alpha = np.arctan2(direction[:, 0], -direction[:, 1])  # inwards, to the left of a counter-clockwise outline
    d = np.cos(alpha) * corners[:, 0] + np.sin(alpha) * corners[:, 1]
    return np.column_stack([alpha, d]), np.stack([corners, following], axis=1)


LOOSELY = np.diag([0.04, 0.04, 0.01])


def believed(pose, cov=LOOSELY):
    walls, extents = room()
    return Estimate(pose, cov, np.arange(len(walls)), walls, np.ones(len(walls), dtype=bool)), extents


def seen(pose, corners=CORNERS):
    """Observations of the walls from a pose."""
    walls, extents = room(corners)
    z, _, _ = predict_walls(pose, walls)
    observations = []
    for (alpha, d), extent in zip(z, extents, strict=True):
        along = np.array([-math.sin(alpha), math.cos(alpha)])
        reach = sorted((pose.inverse() @ extent) @ along)
        observations.append(Observation(Kind.WALL, np.array([alpha, d]), np.diag([1e-4, 1e-4]), (reach[0], reach[1])))
    return observations


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.08), (-0.2, 0.3, -0.15), (0.1, 0.1, 0.27)])
def test_a_room_is_aligned_from_a_wrong_prediction(off):
    true = Pose(0.4, -0.3, 0.9)
    estimate, extents = believed(Pose(true.x + off[0], true.y + off[1], true.theta + off[2]))
    found = align(seen(true), estimate, extents, 0.5, AlignConfig())
    assert found.explained == pytest.approx(1.0)
    # The prediction is a prior with a small weight.
    assert (
        math.dist(found.pose.position, true.position) < 0.02 and abs(wrap_angle(found.pose.theta - true.theta)) < 0.01
    )


def test_without_further_initial_headings_a_large_heading_error_is_not_corrected():
    true = Pose(0.4, -0.3, 0.9)
    estimate, extents = believed(Pose(true.x, true.y, true.theta + 0.4), np.diag([0.04, 0.04, 0.04]))
    lazy = align(seen(true), estimate, extents, 0.5, AlignConfig(headings_rad=(1e-6, 1e-6), reach_rad=0.2))
    found = align(seen(true), estimate, extents, 0.5, AlignConfig(reach_rad=0.2))
    assert lazy.explained < 0.5 < found.explained
    assert abs(wrap_angle(found.pose.theta - true.theta)) < 0.02


def test_walls_that_the_map_lacks_do_not_change_the_alignment():
    pose = Pose(0.1, 0.2, 0.3)
    estimate, extents = believed(pose)
    beyond = seen(pose, CORNERS + np.array([40.0, 0.0]))
    assert align(beyond, estimate, extents, 0.5, AlignConfig()).pose.array() == pytest.approx(pose.array())
    assert align([], estimate, extents, 0.5, AlignConfig()).explained == 0.0
    nothing = Estimate(pose, np.zeros((3, 3)), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, dtype=bool))
    assert align(seen(pose), nothing, np.zeros((0, 2, 2)), 0.5, AlignConfig()).pose == pose


def test_along_a_corridor_the_predicted_position_is_kept():
    true, believed_at = Pose(1.0, 0.0, 0.0), Pose(0.0, 0.1, 0.05)
    long = np.array([[-50.0, -1.0], [50.0, -1.0], [50.0, 1.0], [-50.0, 1.0]])
    walls, extents = room(long)
    estimate = Estimate(believed_at, np.diag([0.5, 0.1, 0.01]), np.arange(2), walls[[0, 2]], np.ones(2, dtype=bool))
    observations = [seen(true, long)[k] for k in (0, 2)]
    found = align(observations, estimate, extents[[0, 2]], 0.5, AlignConfig()).pose
    assert abs(found.y) < 0.01 and abs(found.theta) < 0.01 and abs(found.x - believed_at.x) < 0.05


def test_residuals_agree_with_geometry_and_jacobians_with_finite_differences():
    pose, rng = np.array([0.3, -0.2, 0.4]), np.random.default_rng(3)
    walls, extents = room()
    true = Pose.from_array(pose + 0.05 * rng.standard_normal(3))
    pieces = np.array([true.inverse() @ extent[::-1] for extent in extents])  # normals lie to their right
    normals = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    reach = np.sort(np.einsum("nek,nk->ne", extents, along), axis=1)
    lines = np.column_stack([normals, walls[:, 1], reach])

    def residuals(at):
        placed = np.array([Pose.from_array(at) @ piece for piece in pieces])
        return np.einsum("nek,nk->ne", placed, normals) - walls[:, 1:2]

    rows = np.empty((len(pieces), 2, 4))
    _residuals(pieces, pose, lines, 0.6, 0.2, 0.5, rows)
    assert np.allclose(rows[:, :, 0], residuals(pose))
    for k in range(3):
        step = np.eye(3)[k] * 1e-6
        numeric = (residuals(pose + step) - residuals(pose - step)) / 2e-6
        assert np.allclose(rows[:, :, 1 + k], numeric, atol=1e-7)
