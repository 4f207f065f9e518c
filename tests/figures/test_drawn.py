"""What is drawn of a run that is made by hand, from a second source: curves, bands, labels, bars and places."""

import dataclasses
import math
import types

import numpy as np
import pytest
from made_run import UNDEFINED, made_run
from matplotlib.figure import Figure
from scipy.stats import chi2

from sixthsense import figures
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.evaluation.calibrate import Calibration
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import curves, scan_covariances
from sixthsense.evaluation.groups import Group
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.evaluation.noise import LandmarkErrors, PropagationErrors
from sixthsense.evaluation.results import Metrics
from sixthsense.figures import calibration, groups, plot
from sixthsense.figures.canvas import in_millimetres
from sixthsense.figures.navigation import draw_path, draw_robot, draw_seen
from sixthsense.figures.overtime import draw_stages
from sixthsense.figures.report import page

TRACE = made_run()
DEGREES = 180.0 / math.pi


@pytest.fixture
def ax():
    return Figure().add_subplot()


def line(ax, label):
    return next(one for one in ax.get_lines() if str(one.get_label()).startswith(label))


def edges(ax, which=0):
    """(M, 2) outline of a filled band."""
    return ax.collections[which].get_paths()[0].vertices


@pytest.mark.parametrize(("component", "scale"), [(0, 1.0), (1, 1.0), (2, DEGREES)])
@pytest.mark.parametrize("over", ["time", "distance"])
def test_errors_are_drawn_in_three_sigmas_in_the_unit_of_their_axis(ax, component, scale, over):
    figures.draw_error(ax, TRACE, component, over=over)
    errors = [
        e.pose.array()[component] - t[component] for e, t in zip(TRACE.key_estimates, TRACE.key_truths, strict=True)
    ]
    errors = [math.remainder(error, 2.0 * math.pi) for error in errors]
    np.testing.assert_allclose(line(ax, "keyframes").get_ydata(), scale * np.array(errors))
    own = curves(TRACE)
    at_keys = [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    np.testing.assert_allclose(line(ax, "keyframes").get_xdata(), own.over(over)[at_keys])
    np.testing.assert_array_equal(line(ax, "scans").get_xdata(), own.over(over))
    every = [e[component] - t[component] for e, t in zip(TRACE.estimates, TRACE.truths, strict=True)]
    every = scale * np.array([math.remainder(error, 2.0 * math.pi) for error in every])
    np.testing.assert_allclose(line(ax, "scans").get_ydata(), every)
    places = line(ax, "scans").get_xdata()
    assert len(places) == len(TRACE.stamps_ns) and np.all(np.diff(places) >= 0.0)
    if over == "time":
        np.testing.assert_allclose(places, (np.array(TRACE.stamps_ns) - TRACE.stamps_ns[0]) / 1e9)
    rms = [math.sqrt(np.mean(np.square(one))) for one in (every, scale * np.array(errors))]
    of_scans, of_keys = (f"{one:.3g}°" if component == 2 else f"{1e3 * one:.3g} mm" for one in rms)
    assert max(rms[:1]) < 0.1 or component == 2
    assert ax.texts[0].get_text() == f"RMS of scans {of_scans}, of keyframes {of_keys}"
    bound = 3.0 * scale * np.sqrt(scan_covariances(TRACE)[:, component, component])
    assert (edges(ax)[:, 1].min(), edges(ax)[:, 1].max()) == pytest.approx((-max(bound), max(bound)))
    ax.clear()
    figures.draw_error(ax, dataclasses.replace(TRACE, since_covs=[]), component, over=over)
    bound = [3.0 * scale * math.sqrt(estimate.pose_cov[component, component]) for estimate in TRACE.key_estimates]
    assert (edges(ax)[:, 1].min(), edges(ax)[:, 1].max()) == pytest.approx((-max(bound), max(bound)))
    assert f"[{'°' if component == 2 else 'm'}]" in ax.get_ylabel()


def test_the_nees_is_drawn_from_full_rank_on_in_its_band(ax):
    figures.draw_nees(ax, TRACE, label="made")
    values, found = line(ax, "made").get_ydata(), measure(TRACE)
    assert values.mean() == pytest.approx(found["pose_nees_world_mean"])
    at_keys = [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    np.testing.assert_allclose(line(ax, "made").get_xdata(), curves(TRACE).time_s[at_keys][UNDEFINED:])
    low, high = chi2.ppf((0.025, 0.975), 3)
    share = 100.0 * np.mean((values > low) & (values < high))
    assert line(ax, "made").get_label() == f"made: mean {values.mean():.2f}, {share:.0f} % in band"
    band = ax.patches[0].get_extents().transformed(ax.transData.inverted())
    assert (band.y0, band.y1) == pytest.approx((low, high))
    assert any(list(one.get_ydata()) == [3.0, 3.0] for one in ax.get_lines())


def test_the_nis_is_drawn_per_degree_of_freedom_in_the_band_of_each_keyframe(ax):
    figures.draw_nis(ax, TRACE)
    nis, dof = np.array([(a.nis, a.dof) for a in TRACE.associations]).T
    expected = [n / d if d else np.nan for n, d in zip(nis, dof, strict=True)]
    label = f"mean {nis.sum() / dof.sum():.2f}"
    np.testing.assert_allclose(line(ax, label).get_ydata(), expected)
    outline = np.concatenate([path.vertices[:, 1] for path in ax.collections[0].get_paths()])
    assert (outline.min(), outline.max()) == pytest.approx((chi2.ppf(0.025, 2) / 2, chi2.ppf(0.975, 2) / 2))


def test_the_seen_share_is_drawn_in_per_cent_over_seconds(ax):
    figures.draw_coverage(ax, TRACE)
    area, shares = coverage_of(TRACE)
    drawn = line(ax, f"{area.square_metres:.0f} m² visible")
    np.testing.assert_allclose(drawn.get_ydata(), 100.0 * shares)
    np.testing.assert_allclose(drawn.get_xdata(), 1e-9 * (np.array(TRACE.stamps_ns) - TRACE.stamps_ns[0]))


def test_stages_have_a_bar_of_each_run_with_its_times(ax):
    runs = [{"stage_ms_mean.extract": 3.26, "stage_ms_mean.update": 12.4, "scan_ms_p50": 9.96, "scan_ms_p99": 31.2},
            {"stage_ms_mean.extract": 1.4, "scan_ms_p50": 9.94, "scan_ms_p99": 8.7}]  # fmt: skip
    draw_stages(ax, runs, ["one", "two"])
    assert [[bar.get_width() for bar in bars] for bars in ax.containers] == [
        [3.26, 12.4],
        [1.4, pytest.approx(np.nan, nan_ok=True)],
    ]
    assert [text.get_text() for text in ax.texts] == ["3.3", "12", "1.4", ""]
    told = "keyframe: median {} ms, 99 % below {} ms"
    assert ax.get_legend_handles_labels()[1] == ["one: " + told.format(10, 31), "two: " + told.format(9.9, 8.7)]


def group(values, metrics=None, nees=None):
    """A group of runs with constant errors."""
    time_s = 1.5 * np.arange(30)
    found = []
    for k, value in enumerate(values):
        constant = np.full(30, value)
        curve = types.SimpleNamespace(
            over=lambda over: time_s if over == "time" else 0.3 * time_s, position_m=constant,
            heading_rad=0.02 * constant, nees=constant if nees is None else nees[k],
        )  # fmt: skip
        found.append(types.SimpleNamespace(curves=lambda curve=curve: curve, metrics=metrics[k] if metrics else {}))
    return Group("g", tuple(found))


def test_the_spread_of_a_group_is_its_median_and_from_ten_to_ninety_per_cent(ax):
    values = [1.3, 7.1, 2.6, 4.4, 3.2]
    for quantity, scale in (("position_m", 1.0), ("heading_rad", 0.02 * DEGREES)):
        one = Figure().add_subplot()
        groups.draw_spread(one, group(values), quantity, "time")
        assert set(np.round(line(one, "g, 5 runs").get_ydata(), 9)) == {round(scale * 3.2, 9)}
        limits = edges(one)[:, 1].min(), edges(one)[:, 1].max()
        assert limits == pytest.approx((scale * (1.3 + 0.4 * 1.3), scale * (4.4 + 0.6 * 2.7)))  # 0.4 and 3.6 of 4 steps


def test_the_averaged_nees_has_the_band_of_the_group_with_the_fewest_runs(ax):
    nees = [np.full(30, 1.2), np.linspace(2.0, 9.0, 30)]
    groups.draw_mean_nees(ax, [group([1, 1, 1, 1]), group([1, 1], nees=nees)], "time")
    assert (edges(ax)[:, 1].min(), edges(ax)[:, 1].max()) == pytest.approx(tuple(chi2.ppf((0.025, 0.975), 6) / 2))
    drawn = line(ax, "g, 2 runs: mean")
    assert drawn.get_ydata()[[0, -1]] == pytest.approx([(1.2 + 2.0) / 2, (1.2 + 9.0) / 2])
    assert drawn.get_label() == f"g, 2 runs: mean {drawn.get_ydata().mean():.2f}"


def test_relative_errors_are_drawn_at_the_median_with_the_distances_to_ten_and_ninety_per_cent(ax):
    scales = {"trans_m": 1.0, "rot_deg": 7.0}
    rows = [{f"rpe_{p}_{m}m": by * one * m for p, by in scales.items() for m in (1, 2, 5)} for one in (0.1, 0.4, 0.2)]
    groups.draw_relative_errors(ax, [group([1, 2, 3], rows)], "rot_deg")
    (bars,) = ax.containers
    np.testing.assert_allclose(bars[0].get_ydata(), [1.4, 2.8, 7.0, np.nan])
    limits = np.array([segment[:, 1] for segment in bars[2][0].get_segments()[:3]])
    assert limits == pytest.approx(7.0 * np.outer([1, 2, 5], [0.12, 0.36]))


def test_a_calibration_is_drawn_with_second_moments_about_zero_and_whitened_errors():
    rng = np.random.default_rng(3)
    kinds = np.where(np.arange(60) % 3, float(Kind.CORNER), float(Kind.END))
    root = np.array([[0.004, 0.0, 0.0], [0.002, 0.003, 0.0], [0.001, -0.002, 0.006]])
    covs, drawn = np.tile(root @ root.T, (60, 1, 1)), []
    for scale in (2.0, 1.1):
        errors = scale * rng.normal(0.001, 0.003, (60, 3))
        drawn.append((PropagationErrors(errors, covs), LandmarkErrors(kinds, errors[:, :2], covs[:, :2, :2], 0)))
    found = Calibration(None, {}, (drawn[0][0], drawn[1][0]), (drawn[0][1], drawn[1][1]))
    saved = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "save", lambda figure, file: saved.append(figure))
        calibration.save_calibration(found, "x.png", "a title")
    for ax, kind in zip(saved[0].axes, (Kind.CORNER, Kind.END), strict=False):
        mm = 1000.0 * found.landmarks[1].errors[kinds == kind]
        np.testing.assert_allclose(ax.collections[0].get_offsets(), mm)
        assert line(ax, "sample mean").get_xydata()[0] == pytest.approx(mm.mean(axis=0))
        outline = line(ax, "95 %").get_xydata()
        moment = sum(np.outer(row, row) for row in mm) / len(mm)
        assert np.einsum("ki,ij,kj->k", outline, np.linalg.inv(moment), outline) == pytest.approx(
            chi2.ppf(0.95, 2), rel=1e-4
        )
    white = np.linalg.solve(root, drawn[1][0].errors.T).T  # the root is lower triangular, as Cholesky's
    np.testing.assert_allclose(saved[0].axes[2].collections[1].get_offsets(), white[:, [0, 2]], rtol=1e-5)


def test_the_map_has_the_covariance_of_each_point_and_the_extent_of_the_known_cells():
    points, covs, extents = plot.landmarks_of(TRACE)
    np.testing.assert_array_equal(points, TRACE.final.landmarks[[2, 4, 5, 6]])
    for cov, row in zip(covs, (7, 11, 13, 15), strict=True):
        np.testing.assert_array_equal(cov, TRACE.joint_cov[row : row + 2, row : row + 2])
    assert len(extents) == 3
    cells = np.full((9, 13), -1, dtype=np.int8)
    cells[2:5, 3:10] = 0
    cells[3, 4] = 100
    grid = types.SimpleNamespace(occupancy=lambda: cells, origin=(-2.3, 1.7))
    shown, extent = plot.known_cells(dataclasses.replace(TRACE, grid=grid))
    cell = TRACE.config.grid.cell_m
    assert shown.shape == (3, 7) and shown[1, 1] == 100
    assert extent == pytest.approx((-2.3 + 3 * cell, -2.3 + 10 * cell, 1.7 + 2 * cell, 1.7 + 5 * cell))


def test_a_robot_points_along_its_heading_a_path_has_its_way_point_and_a_mask_its_place(ax):
    draw_robot(ax, Pose(1.3, 0.4, 2.1), 0.35)
    ends = ax.get_lines()[0].get_xydata()
    np.testing.assert_allclose(ends, [[1.3, 0.4], [1.3 + 0.35 * math.cos(2.1), 0.4 + 0.35 * math.sin(2.1)]])
    plan = np.array([[0.2, 0.3], [1.1, 0.9], [2.4, 0.7]])
    draw_path(ax, plan, plan[[0, 2]] + 0.1)
    assert [one.get_offsets()[0].tolist() for one in ax.collections] == [[2.5, pytest.approx(0.8)], [2.4, 0.7]]
    space = types.SimpleNamespace(seen=np.eye(4, 7, dtype=bool), origin=(0.3, -1.2), cell_m=0.2)
    draw_seen(ax, space)
    assert ax.images[0].get_extent() == pytest.approx((0.3, 1.7, -1.2, -0.4))


def test_a_page_of_two_runs_has_the_metrics_of_each_and_of_one_run_its_settings_beside_the_defaults():
    one = MeasuredRun("one", TRACE, Metrics({"ate_rmse_m": 0.12345678}))
    two = MeasuredRun("two", TRACE, Metrics({"ate_rmse_m": 7.25, "plans": 3}))
    text = page([one, two], {})
    assert '<td class="value">0.1235</td><td class="value">7.25</td><td>m</td>' in text
    assert '<td class="value"></td><td class="value">3</td>' in text
    assert "laser.fov</td>" in page([one], {}) and ">3.9</td>" in page([one], {})


@pytest.mark.parametrize(
    ("label", "high", "told", "tick"),
    [("error of x [m]", 0.083, "error of x [mm]", "\N{MINUS SIGN}12.5"),
     ("error of x [m]", 0.13, "error of x [m]", None), ("error of heading [°]", 0.083, "error of heading [°]", None),
     ("y [m]", 0.083, "y [m]", None)],
)  # fmt: skip
def test_short_lengths_are_told_in_millimetres(label: str, high: float, told: str, tick: str | None) -> None:
    ax = plot.new_figure(4.0, 3.0).add_subplot()
    ax.set(ylabel=label, ylim=(-0.031, high))
    in_millimetres(ax)
    assert ax.get_ylabel() == told and (tick is None or ax.yaxis.get_major_formatter()(-0.0125, 0) == tick)
