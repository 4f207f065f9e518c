import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sixthsense.config import preset
from sixthsense.core.geometry import Array
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
def test_the_ellipse_contains_95_percent_of_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=2), random_cov(rng)
    outline = ellipse(mean, cov, 181)
    samples = rng.multivariate_normal(mean, cov, 5_000)
    # A point is inside a convex outline, given counter-clockwise or clockwise, if it is on one side of all its edges.
    start, along = outline[:-1], np.diff(outline, axis=0)
    offset = samples[:, None] - start
    side = along[:, 0] * offset[:, :, 1] - along[:, 1] * offset[:, :, 0]
    inside = np.all(side >= 0.0, axis=1) | np.all(side <= 0.0, axis=1)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize("seed", range(3))
def test_every_point_of_the_ellipse_has_the_same_mahalanobis_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=2), random_cov(rng)
    offset = ellipse(mean, cov) - mean
    squared = np.einsum("ki,ki->k", offset, np.linalg.solve(cov, offset.T).T)
    assert squared == pytest.approx(5.991, rel=1e-6)


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
