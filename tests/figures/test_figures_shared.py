"""Figures that notebooks and benchmarks share: what they compare, and what they draw where."""

import numpy as np
import pytest

from sixthsense import figures, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.figures.plot import CHI2_95, new_figure
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.features import Features
from sixthsense.sources.scene import load_scene


@pytest.fixture(scope="module")
def run():
    return figures.record(preset("default", scene="rectangle", task="goal", features={"landmarks": "corners"}))


@pytest.fixture
def ax():
    return new_figure(4.0, 4.0).add_subplot()


def features(points, walls):
    observations = tuple(Observation(Kind.CORNER, np.array(p, dtype=float), 1e-4 * np.eye(2)) for p in points)
    return Features(np.array(walls, dtype=float).reshape(-1, 2, 2), observations, (), ())


def test_a_recording_keeps_a_scan_for_each_keyframe(run):
    assert len(run.scans) == len(run.plans) == len(run.trace.key_stamps_ns)
    np.testing.assert_array_equal(run.way(0)[-1], np.array(run.trace.estimates)[0, :2])


def test_a_recording_rebuilds_the_last_map(run):
    np.testing.assert_array_equal(run.grid(len(run.scans) - 1).hits, run.trace.grid.hits)


def test_a_scan_compared_with_itself_has_no_lost_or_gained_features(run):
    seen = run.features(0)
    change = figures.compare_features(seen, seen)
    assert (len(change.lost), len(change.gained), len(change.walls_lost), len(change.walls_gained)) == (0, 0, 0, 0)
    assert len(change.kept) == len(seen.observations)
    assert len(change.walls_kept) == len(seen.walls)


def test_points_and_walls_of_only_one_extraction_are_lost_or_gained():
    along, across = [[0.0, 0.0], [2.0, 0.0]], [[0.0, 1.0], [0.0, 3.0]]
    usual = features([(0.0, 0.0), (2.0, 0.0)], [along])
    change = figures.compare_features(features([(0.05, 0.0), (0.0, 3.0)], [across]), usual)
    np.testing.assert_array_equal(change.kept, [[0.05, 0.0]])
    np.testing.assert_array_equal(change.lost, [[2.0, 0.0]])
    np.testing.assert_array_equal(change.gained, [[0.0, 3.0]])
    np.testing.assert_array_equal(change.walls_lost, [along])
    np.testing.assert_array_equal(change.walls_gained, [across])
    assert "1 lost, 1 gained" in str(change)


def test_a_piece_of_a_wall_is_kept_and_the_whole_lost():
    change = figures.compare_features(features([], [[[0, 0], [1, 0]]]), features([], [[[0, 0], [4, 0]]]))
    assert len(change.walls_kept) == len(change.walls_lost) == 1


def test_the_error_of_a_wall_is_its_distance_from_the_true_walls():
    scene = load_scene("rectangle")
    wall = scene.walls[:1]
    assert figures.strays_m(Pose(), features([], wall), scene) == pytest.approx(0.0, abs=1e-12)
    inward = wall + 0.3 * (scene.walls.reshape(-1, 2).mean(axis=0) - wall.mean(axis=1))
    assert figures.strays_m(Pose(), features([], inward), scene) > 0.1


def test_a_run_without_removed_landmarks_is_refused(run):
    if run.trace.culled == 0:
        with pytest.raises(ValueError, match="run: found no removed landmark, allowed: a run with one"):
            figures.worst_culled(run)
    else:
        assert figures.worst_culled(run).born < figures.worst_culled(run).gone


def test_the_band_of_a_wall_has_the_width_of_its_variance(ax):
    wall = Observation(Kind.WALL, np.array([0.0, 2.0]), np.diag([1e-4, 1e-6]), (-1.0, 3.0))
    figures.draw_wall_bands(ax, Pose(), [wall])
    outline = ax.patches[0].get_xy()
    half = np.abs(outline[:, 0] - 2.0)
    np.testing.assert_allclose(half.max(), 1.96 * np.sqrt(1e-6 + 9.0 * 1e-4))
    np.testing.assert_allclose(outline[half.argmax(), 1], 3.0)


def test_the_ellipse_of_the_pose_has_the_size_of_its_covariance(ax):
    estimator = make_estimator("ekf", Pose(1.0, 2.0, 0.0), np.zeros((3, 3)))
    estimator.predict(Odometry(Pose(1.0, 0.0, 0.0), np.diag([0.04, 0.01, 0.01])))
    figures.draw_state(ax, estimator, enlarged=2.0)
    outline = ax.get_lines()[0].get_xydata()
    np.testing.assert_allclose(np.ptp(outline[:, 0]), 2.0 * 2.0 * 0.2 * np.sqrt(CHI2_95), rtol=1e-2)


def test_gates_are_drawn_at_the_given_distance(ax):
    figures.draw_innovations(ax, Pose(), np.zeros((1, 2)), np.zeros((1, 2)), np.eye(2)[None], gate=9.0)
    assert np.abs(ax.get_lines()[0].get_xydata()).max() == pytest.approx(3.0, rel=1e-2)


def test_correlations_have_a_diagonal_of_ones(ax):
    figures.draw_correlation(ax, np.array([[4.0, 1.0], [1.0, 1.0]]), "two")
    np.testing.assert_allclose(ax.images[0].get_array(), [[1.0, 0.5], [0.5, 1.0]])


def test_walls_are_placed_by_the_trajectory(run, ax):
    poses = run.trace.scan_poses()
    figures.draw_walls_at(ax, run.trace, poses)
    drawn = np.array(ax.collections[0].get_segments())
    np.testing.assert_allclose(drawn[0], Pose.from_array(poses[0]) @ run.trace.walls_found[0][0])
    assert len(drawn) == sum(len(walls) for walls in run.trace.walls_found)


def test_cells_are_coloured_at_their_positions(run, ax):
    space = run.grid(0).free_space()
    figures.draw_region(ax, space, np.array([0, space.blocked.shape[1]], dtype=np.int32))
    shown = ax.images[0].get_array()[..., 3] > 0
    assert shown.sum() == 2
    assert shown[0, 0]
    assert shown[1, 0]


def test_one_legend_has_each_label_once():
    figure, axes = figures.new_axes(1, 2, 6.0, 3.0)
    for each in axes:
        each.plot([0, 1], label="way")
    figures.legend(figure)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["way"]


def test_a_picture_in_a_notebook_has_a_palette():
    figure, (ax,) = figures.new_axes(1, 1, 4.0, 3.0)
    ax.plot([0, 1])
    assert b"PLTE" in figure._repr_png_()
