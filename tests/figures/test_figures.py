import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

from sixthsense import figures
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import LaserConfig, Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.evaluation.measure import measure
from sixthsense.record.trace import Trace

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


@pytest.mark.parametrize("frame", ["world", "invariant"])
def test_the_nees_drawn_has_the_mean_of_the_metrics(ax, trace, frame):
    figures.draw_nees(ax, trace, frame)
    mean = measure(trace)[f"pose_nees_{frame}_mean"]
    assert line(ax, "mean").get_ydata().mean() == pytest.approx(mean)
    assert ax.get_ylabel() == f"pose NEES, {frame} [1]"


def test_the_seen_area_ends_at_the_coverage_of_the_metrics_and_never_shrinks(ax, trace):
    figures.draw_coverage(ax, trace)
    (drawn,) = (np.asarray(one.get_ydata()) for one in ax.get_lines())
    assert (np.diff(drawn) >= 0.0).all()
    assert drawn[-1] == pytest.approx(100.0 * measure(trace)["coverage"])


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
