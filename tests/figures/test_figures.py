import dataclasses
import sys
from unittest import mock

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.figures import slider
from sixthsense.figures.kinds import KINDS
from sixthsense.figures.plot import ellipse, known_blocks
from sixthsense.record.trace import Trace


@pytest.fixture
def trace(explored) -> Trace:
    return explored.trace


@pytest.mark.parametrize("seed", range(3))
def test_every_point_of_an_ellipse_has_the_mahalanobis_distance_that_95_percent_are_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, root = rng.normal(size=2), rng.normal(size=(2, 2))
    cov = root @ root.T
    offset = ellipse(mean, cov) - mean
    squared = np.einsum("ki,ki->k", offset, np.linalg.solve(cov, offset.T).T)
    assert squared == pytest.approx(chi2.ppf(0.95, 2), rel=1e-4)


@pytest.mark.parametrize("what", sorted({*KINDS} - {"rpe"}))
def test_every_figure_is_drawn_on_axes_of_ones_own_without_a_title_and_returns_them(explored, what) -> None:
    own = Figure().subplots({"error": 3}.get(what, 1), 1, squeeze=False)
    assert explored.plot(what, ax=own) is own
    assert all(ax.has_data() and not ax.get_title() and ax.get_legend() for ax in own.ravel())
    one = Figure().add_subplot(title="my own")
    assert explored.plot(what, ax=one) is one
    assert one.has_data() and one.get_title() == "my own"


def test_panels_of_one_comparison_share_their_limits(explored) -> None:
    short = dataclasses.replace(explored.trace, estimates=explored.trace.estimates[:20])
    both = ss.compare({"a": explored, "b": short})
    for what, axes in (("map", "xy"), ("nis", "xy"), ("exploration", "xy")):
        panels = Figure().subplots(1, 2)
        both.plot(what, ax=panels)
        for name in axes:
            first, second = (getattr(ax, f"get_{name}lim")() for ax in panels)
            assert first == second
    with pytest.raises(InputError, match="ax: found 3 axes, allowed: 2"):
        both.plot("map", ax=Figure().subplots(1, 3))


def test_blocks_of_cells_lie_where_the_cells_do_and_keep_every_obstacle(trace: Trace) -> None:
    (cells, (left, right, bottom, top)), (blocks, extent) = known_blocks(trace), known_blocks(trace, 37)
    cell_m, side_m = trace.config.grid.cell_m, (extent[1] - extent[0]) / blocks.shape[1]
    assert max(blocks.shape) <= 38 and extent[0] <= left + 1e-9 and extent[1] >= right - 1e-9
    assert extent[2] <= bottom + 1e-9 and extent[3] >= top - 1e-9
    rows, cols = np.nonzero(cells == 100)
    at = np.floor((bottom + (rows + 0.5) * cell_m - extent[2]) / side_m).astype(int)
    across = np.floor((left + (cols + 0.5) * cell_m - extent[0]) / side_m).astype(int)
    assert set(zip(at.tolist(), across.tolist(), strict=True)) == set(zip(*np.nonzero(blocks == 100), strict=True))


def test_a_slider_draws_again_when_it_is_moved_and_without_widgets_the_start_is_shown(monkeypatch):
    widgets = pytest.importorskip("ipywidgets")
    from IPython import display

    shown, handle = [], mock.Mock()
    monkeypatch.setattr(display, "display", lambda one, **options: shown.append(one) or handle)
    slider(lambda value: f"drawn at {value}", (1, 2, 3), 2, "value")
    (moved,) = [one for one in shown if isinstance(one, widgets.SelectionSlider)]
    moved.value = 3
    handle.update.assert_called_once_with("drawn at 3")
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    slider(lambda value: f"drawn at {value}", (1, 2, 3), 1, "value")
    assert shown[1:] == ["drawn at 2", "drawn at 1"]
