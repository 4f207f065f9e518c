import dataclasses
import itertools

import numpy as np
import pytest
from matplotlib.figure import Figure

from sixthsense import figures
from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import LaserConfig, Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.evaluation.coverage import coverage, coverage_over_time, visible_area
from sixthsense.evaluation.measure import measure
from sixthsense.record.trace import Trace
from sixthsense.slam.features import Features, extract

ROOM = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[2, 2], [-2, 2]], [[-2, 2], [-2, -2]]], dtype=np.float64)


@pytest.fixture
def trace(explored) -> Trace:
    return explored.trace


@pytest.fixture(scope="module")
def scan() -> Scan:
    laser = LaserConfig()
    return Scan.from_config(cast_rays(Pose(0.3, 0.2, 0.1), beam_bearings(laser), ROOM, 10.0), laser)


@pytest.fixture
def ax():
    return Figure().add_subplot()


def line(ax, label: str):
    return next(one for one in ax.get_lines() if str(one.get_label()).startswith(label))


@pytest.mark.parametrize("component", range(3))
def test_the_error_drawn_is_estimate_minus_truth_in_the_unit_of_the_axis(ax, trace, component):
    figures.draw_error(ax, trace, component)
    expected = np.array([e.pose.array() for e in trace.key_estimates]) - np.array(trace.key_truths)
    expected[:, 2] = np.degrees(wrap_angle(expected[:, 2]))
    np.testing.assert_allclose(line(ax, "error").get_ydata(), expected[:, component])
    assert f"[{figures.COMPONENTS[component].unit}]" in ax.get_ylabel()
    assert ax.get_xlabel() == "time [s]"


def test_a_heading_error_is_wrapped_at_pi(ax, trace):
    turned = dataclasses.replace(
        trace,
        key_estimates=[dataclasses.replace(trace.key_estimates[0], pose=Pose(theta=np.pi - 0.01))],
        key_truths=[np.array([0.0, 0.0, -np.pi + 0.01])],
        key_stamps_ns=[trace.stamps_ns[0]],
    )
    figures.draw_error(ax, turned, 2)
    assert line(ax, "error").get_ydata()[0] == pytest.approx(np.degrees(-0.02))


@pytest.mark.parametrize("frame", ["world", "invariant"])
def test_the_nees_drawn_has_the_mean_of_the_metrics(ax, trace, frame):
    figures.draw_nees(ax, trace, frame)
    mean = measure(trace)[f"pose_nees_{frame}_mean"]
    assert line(ax, "mean").get_ydata().mean() == pytest.approx(mean)
    assert ax.get_ylabel() == f"pose NEES, {frame} [1]"


def test_the_nis_drawn_is_per_degree_of_freedom_with_gaps_where_nothing_matched(ax, trace):
    figures.draw_nis(ax, trace)
    drawn = np.asarray(line(ax, "mean").get_ydata())
    for value, association in zip(drawn, trace.associations, strict=True):
        if association.dof:
            assert value == pytest.approx(association.nis / association.dof)
        else:
            assert np.isnan(value)


def test_the_seen_area_ends_at_the_coverage_of_the_metrics_and_never_shrinks(ax, trace):
    figures.draw_coverage(ax, trace)
    (drawn,) = (np.asarray(one.get_ydata()) for one in ax.get_lines())
    assert (np.diff(drawn) >= 0.0).all()
    assert drawn[-1] == pytest.approx(100.0 * measure(trace)["coverage"])


@pytest.mark.parametrize("upto", [1, 2, 7, 20])
def test_coverage_over_time_is_the_coverage_up_to_each_scan(trace, upto):
    laser, walls = trace.config.laser, trace.scene.walls
    poses = np.array(trace.truths)
    area = visible_area(walls, trace.scene.region, tuple(poses[0, :2]), trace.radius_m, laser.max_range)
    arguments = beam_bearings(laser), laser.mount, laser.max_range, walls
    shares = coverage_over_time(area, poses, *arguments)
    assert shares.shape == (len(poses),)
    assert shares[upto - 1] == coverage(area, poses[:upto], *arguments)


def test_the_stages_drawn_are_those_of_any_run_and_a_missing_one_has_no_bar(ax):
    figures.draw_stages(ax, [{"stage_ms_mean.extract": 1.0}, {"stage_ms_mean.plan": 2.0}], ["a", "b"])
    assert [label.get_text() for label in ax.get_yticklabels()] == ["extract", "plan"]
    widths = [[bar.get_width() for bar in bars] for bars in ax.containers]
    np.testing.assert_array_equal(widths, [[1.0, np.nan], [np.nan, 2.0]])


def test_times_of_stages_are_written_without_exponents(ax):
    figures.draw_stages(ax, [{"stage_ms_mean.plan": 1234.5, "scan_ms_p50": 9.96, "scan_ms_p99": 127.0}])
    assert [text.get_text() for text in ax.texts] == ["1234"]
    assert ax.get_legend_handles_labels()[1] == ["keyframe: median 10 ms, 99 % below 127 ms"]


def test_a_run_without_keyframes_can_be_drawn(trace):
    nothing = dataclasses.replace(trace, key_stamps_ns=[], key_estimates=[], key_truths=[], associations=[])
    for k in range(3):
        figures.draw_error(Figure().add_subplot(), nothing, k)
    figures.draw_nees(Figure().add_subplot(), nothing, "world")
    figures.draw_nis(Figure().add_subplot(), nothing)


def test_returns_lie_on_the_walls_at_the_ends_of_the_beams(ax, scan):
    pose = Pose(0.3, 0.2, 0.1)
    figures.draw_returns(ax, pose, scan)
    points = np.asarray(ax.collections[0].get_offsets())
    np.testing.assert_allclose(np.abs(points).max(axis=1), 2.0, atol=1e-5)
    figures.draw_beams(ax, pose, scan)
    ends = np.array([segment[1] for segment in ax.collections[1].get_segments()])
    np.testing.assert_allclose(ends, points, atol=1e-9)


def test_a_beam_without_a_return_has_the_maximum_range_and_no_point(ax):
    laser = LaserConfig(max_range=1.0)
    empty = Scan.from_config(np.full(laser.beams, np.inf), laser)
    figures.draw_beams(ax, Pose(), empty)
    ends = np.array([segment[1] for segment in ax.collections[0].get_segments()])
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), 1.0)
    figures.draw_returns(ax, Pose(), empty)
    assert np.ma.getmaskarray(np.ma.masked_invalid(ax.collections[1].get_offsets())).all()


def test_adjacent_partitions_differ_in_colour(ax, scan):
    parts = [np.arange(k, k + 20) for k in range(0, 200, 20)]
    figures.draw_partitions(ax, Pose(), scan, [*parts, np.arange(200, 203)], least=4)
    colors = [tuple(collection.get_facecolor()[0]) for collection in ax.collections[1:]]
    assert len(colors) == 10  # the short one is left grey
    assert all(a != b for a, b in itertools.pairwise(colors))


def test_detections_are_drawn_at_their_positions(ax, scan):
    config = preset(features={"landmarks": "corners"})
    features = extract(scan, config.assumed, config.features, np.random.default_rng(0))
    figures.draw_detections(ax, Pose(0.3, 0.2, 0.1), features, enlarged=2.0)
    corners = np.asarray(ax.collections[1].get_offsets())
    assert len(corners) == 4
    np.testing.assert_allclose(np.abs(corners), 2.0, atol=0.01)
    figures.draw_detections(ax, Pose(), Features(np.zeros((0, 2, 2)), (), (), ()))


def test_drawing_a_grid_keeps_the_limits_of_the_axes(ax, trace):
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    figures.draw_seen(ax, trace.grid.free_space())
    figures.draw_hits(ax, trace.grid, trace.config.grid.cell_m)
    assert (ax.get_xlim(), ax.get_ylim()) == ((0.0, 1.0), (0.0, 1.0))
    assert len(ax.images) == 3


def test_the_current_way_point_is_the_first_one_ahead(ax):
    plan = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]])
    figures.draw_path(ax, plan, plan[[0, 2, 3]])
    local, goal = (np.asarray(collection.get_offsets())[0] for collection in ax.collections)
    np.testing.assert_array_equal(local, plan[2])
    np.testing.assert_array_equal(goal, plan[3])


def test_the_robot_is_drawn_with_its_heading(ax):
    figures.draw_robot(ax, Pose(1.0, 2.0, np.pi / 2), 0.5)
    np.testing.assert_allclose(ax.get_lines()[0].get_xydata(), [[1.0, 2.0], [1.0, 2.5]])
