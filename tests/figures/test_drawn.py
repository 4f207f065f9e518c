"""What is drawn of a run that is made by hand, from a second source: curves, bands, labels, bars and places."""

import dataclasses
import math
import types

import numpy as np
import pandas as pd
import pytest
from made_run import UNDEFINED, made_run
from matplotlib.figure import Figure
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.evaluation.curves import curves, scan_covariances
from sixthsense.evaluation.groups import Sample
from sixthsense.figures import plot
from sixthsense.figures.kinds import plot as draw
from sixthsense.figures.overtime import draw_error, draw_nis, running_mean
from sixthsense.figures.run import Run

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
    draw_error(ax, TRACE, component, over=over)
    errors = [
        e.pose.array()[component] - t[component] for e, t in zip(TRACE.key_estimates, TRACE.key_truths, strict=True)
    ]
    errors = [math.remainder(error, 2.0 * math.pi) for error in errors]
    np.testing.assert_allclose(line(ax, "keyframes").get_ydata(), scale * np.array(errors))
    own = curves(TRACE)["time_s" if over == "time" else "distance_m"]
    at_keys = [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    np.testing.assert_allclose(line(ax, "keyframes").get_xdata(), own[at_keys])
    np.testing.assert_array_equal(line(ax, "scans").get_xdata(), own)
    every = [e[component] - t[component] for e, t in zip(TRACE.estimates, TRACE.truths, strict=True)]
    every = scale * np.array([math.remainder(error, 2.0 * math.pi) for error in every])
    np.testing.assert_allclose(line(ax, "scans").get_ydata(), every)
    np.testing.assert_allclose(line(ax, "running mean").get_ydata(), running_mean(every))
    places = line(ax, "scans").get_xdata()
    assert len(places) == len(TRACE.stamps_ns) and np.all(np.diff(places) >= 0.0)
    if over == "time":
        np.testing.assert_allclose(places, (np.array(TRACE.stamps_ns) - TRACE.stamps_ns[0]) / 1e9)
    rms = [math.sqrt(np.mean(np.square(one))) for one in (every, scale * np.array(errors))]
    of_scans, of_keys = (f"{one:.3g}°" if component == 2 else f"{1e3 * one:.3g} mm" for one in rms)
    assert max(rms[:1]) < 0.1 or component == 2
    assert ax.texts[0].get_text() == f"RMS {of_scans}, keyframes {of_keys}"
    bound = 3.0 * scale * np.sqrt(scan_covariances(TRACE)[:, component, component])
    assert (edges(ax)[:, 1].min(), edges(ax)[:, 1].max()) == pytest.approx((-max(bound), max(bound)))
    assert f"[{'°' if component == 2 else 'm'}]" in ax.get_ylabel()


def test_a_running_mean_is_of_the_values_around_and_leaves_out_what_is_not_known():
    values = np.arange(75.0) ** 1.5
    values[[3, 40]] = np.nan
    expected = [np.nanmean(values[max(0, k - 2) : k + 3]) for k in range(75)]
    np.testing.assert_allclose(running_mean(values), expected)


def test_the_nees_is_drawn_from_full_rank_on_with_the_bands_of_a_pose_and_of_the_mean(ax):
    run = Run("made", TRACE)
    assert run.plot("nees", ax=ax) is ax
    found, points = run.metrics, ax.get_lines()[0]
    assert points.get_ydata().mean() == pytest.approx(found["pose_nees_world_mean"])
    at_keys = [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    np.testing.assert_allclose(points.get_xdata(), curves(TRACE)["time_s"][at_keys][UNDEFINED:])
    samples = found["pose_nees_effective_samples"]
    bands = [one.get_extents().transformed(ax.transData.inverted()) for one in ax.patches]
    expected = [tuple(chi2.ppf((0.025, 0.975), 3 * n) / n) for n in (1, samples)]
    assert [(one.y0, one.y1) for one in bands] == [pytest.approx(one) for one in expected]
    mean = line(ax, "mean")
    np.testing.assert_allclose(mean.get_ydata(), running_mean(points.get_ydata()))
    low, high = expected[1]
    assert mean.get_label() == f"mean {found['pose_nees_world_mean']:.3g} ({low:.2f} to {high:.2f}: too short to tell)"
    said = run.summary["consistency"]
    assert said.startswith("too short to tell") and f"{low:.2f} to {high:.2f} is consistent" in said


def test_the_nis_is_drawn_per_degree_of_freedom_in_the_band_of_each_keyframe(ax):
    draw_nis(ax, TRACE)
    nis, dof = np.array([(a.nis, a.dof) for a in TRACE.associations]).T
    expected = [n / d if d else np.nan for n, d in zip(nis, dof, strict=True)]
    assert line(ax, f"mean {nis.sum() / dof.sum():.2f}")
    np.testing.assert_allclose(ax.get_lines()[1].get_ydata(), expected)
    outline = np.concatenate([path.vertices[:, 1] for path in ax.collections[0].get_paths()])
    assert (outline.min(), outline.max()) == pytest.approx((chi2.ppf(0.025, 2) / 2, chi2.ppf(0.975, 2) / 2))


def group(values, metrics=None, nees=None, name="g"):
    """Runs with constant errors, named as a group."""
    time_s = 1.5 * np.arange(30)
    for k, value in enumerate(values):
        columns = {"time_s": time_s, "distance_m": 0.3 * time_s, "position_m": value, "heading_rad": 0.02 * value}
        curve = pd.DataFrame(columns | {"nees": value if nees is None else nees[k]})
        row = metrics[k] if metrics else {"pose_nees_world_mean": float(curve["nees"].mean())}
        yield Sample(name, ss.preset(seed=k), lambda row=row: row, lambda curve=curve: curve)


def test_the_spread_of_a_group_is_its_median_and_from_ten_to_ninety_per_cent():
    panels = Figure().subplots(2)
    assert draw("error", list(group([1.3, 7.1, 2.6, 4.4, 3.2])), "run", panels) is panels
    for one, scale in zip(panels, (1.0, 0.02 * DEGREES), strict=True):
        assert set(np.round(line(one, "g, 5 runs").get_ydata(), 9)) == {round(scale * 3.2, 9)}
        limits = edges(one)[:, 1].min(), edges(one)[:, 1].max()
        assert limits == pytest.approx((scale * (1.3 + 0.4 * 1.3), scale * (4.4 + 0.6 * 2.7)))  # 0.4 and 3.6 of 4 steps


def test_the_map_has_the_covariance_of_each_point_and_the_extent_of_the_known_blocks():
    points, covs, extents = plot.landmarks_of(TRACE)
    np.testing.assert_array_equal(points, TRACE.final.landmarks[[2, 4, 5, 6]])
    for cov, row in zip(covs, (7, 11, 13, 15), strict=True):
        np.testing.assert_array_equal(cov, TRACE.joint_cov[row : row + 2, row : row + 2])
    assert len(extents) == 3
    cells = np.full((9, 13), -1, dtype=np.int8)
    cells[2:5, 3:10] = 0
    cells[3, 4] = 100
    grid = types.SimpleNamespace(occupancy=lambda: cells, origin=(-2.3, 1.7))
    shown, extent = plot.known_blocks(dataclasses.replace(TRACE, grid=grid))
    cell = TRACE.config.grid.cell_m
    assert shown.shape == (3, 7) and shown[1, 1] == 100
    assert extent == pytest.approx((-2.3 + 3 * cell, -2.3 + 10 * cell, 1.7 + 2 * cell, 1.7 + 5 * cell))
    obstacles = plot.draw_grid(Figure().add_subplot(), dataclasses.replace(TRACE, grid=grid), "0.9", "0.2")
    assert obstacles == pytest.approx(np.array([[-2.3 + 4 * cell, 1.7 + 3 * cell]]))
