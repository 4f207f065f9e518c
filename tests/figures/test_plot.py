import dataclasses
import math
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from PIL import Image
from scipy.stats import chi2

from sixthsense.config import preset
from sixthsense.core.geometry import Array
from sixthsense.figures import slider
from sixthsense.figures.plot import ellipse, save_map
from sixthsense.figures.run import Run
from sixthsense.loop import run
from sixthsense.record.trace import Trace


@pytest.fixture
def trace(explored: Run) -> Trace:
    return explored.trace


def random_cov(rng: np.random.Generator) -> Array:
    angle, sigmas = rng.uniform(0.0, math.pi), np.exp(rng.uniform(-4.0, 2.0, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(turn @ np.diag(sigmas**2) @ turn.T)


@pytest.mark.parametrize("seed", range(3))
def test_every_point_of_an_ellipse_has_the_mahalanobis_distance_that_95_percent_are_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=2), random_cov(rng)
    offset = ellipse(mean, cov) - mean
    squared = np.einsum("ki,ki->k", offset, np.linalg.solve(cov, offset.T).T)
    assert squared == pytest.approx(chi2.ppf(0.95, 2), rel=1e-4)


def test_a_map_is_written_as_a_png_with_its_folder(trace: Trace, tmp_path: Path) -> None:
    save_map(trace, tmp_path / "deep" / "figures" / "map.png", "a title")
    with Image.open(tmp_path / "deep" / "figures" / "map.png") as image:
        image.load()
        assert image.format == "PNG"
        assert image.size[0] > 1000
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 20


def test_a_run_without_returns_can_be_drawn(tmp_path: Path) -> None:
    blind = dataclasses.replace(preset(), scene="rectangle", max_time=0.5)
    blind = dataclasses.replace(blind, laser=dataclasses.replace(blind.laser, max_range=0.01))
    save_map(run(blind), tmp_path / "map.png", "a title")
    assert (tmp_path / "map.png").is_file()


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
    with pytest.raises(ValueError, match="start: found 5, allowed: 1, 2"):
        slider(str, (1, 2), 5, "value")
