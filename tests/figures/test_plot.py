import dataclasses
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from sixthsense.config import preset
from sixthsense.core.geometry import Array, point_segment_distance
from sixthsense.figures.plot import draw_map, ellipse, save_map, walls_found
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


@pytest.mark.parametrize("seed", range(10))
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


@pytest.mark.parametrize("seed", range(10))
def test_every_point_of_the_ellipse_has_the_same_mahalanobis_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=2), random_cov(rng)
    offset = ellipse(mean, cov) - mean
    squared = np.einsum("ki,ki->k", offset, np.linalg.solve(cov, offset.T).T)
    assert squared == pytest.approx(5.991, rel=1e-6)


def test_the_ellipse_of_an_exact_landmark_is_a_point() -> None:
    assert np.array_equal(ellipse(np.array([1.0, 2.0]), np.zeros((2, 2))), np.tile([1.0, 2.0], (48, 1)))


def test_a_map_is_written_as_a_png_with_its_folder(trace: Trace, tmp_path: Path) -> None:
    save_map(trace, tmp_path / "deep" / "figures" / "map.png", "a title")
    with Image.open(tmp_path / "deep" / "figures" / "map.png") as image:
        image.load()
        assert image.format == "PNG"
        assert image.size[0] > 1000
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 20


def test_a_map_is_drawn_without_pyplot_and_without_a_window_system(tmp_path: Path) -> None:
    code = (
        "import sys; from sixthsense.figures.plot import save_map; from sixthsense.config import preset; "
        "import dataclasses; from pathlib import Path; from sixthsense.loop import run; "
        "trace = run(dataclasses.replace(preset(), scene='rectangle', max_time=1.0)); "
        "save_map(trace, Path(sys.argv[1]), 'a title'); "
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "map.png")], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "map.png").is_file()


def test_the_height_of_the_figure_follows_from_the_map(tmp_path: Path) -> None:
    heights = []
    for scene in ("rectangle", "loop"):
        save_map(run(dataclasses.replace(preset(), scene=scene, max_time=0.5)), tmp_path / f"{scene}.png", "a title")
        with Image.open(tmp_path / f"{scene}.png") as image:
            heights.append(image.size[1])
    assert heights[0] < heights[1]


def test_the_legend_has_each_label_once(trace: Trace) -> None:
    ax = Figure().add_subplot()
    draw_map(ax, trace)
    _, labels = ax.get_legend_handles_labels()
    assert len(labels) == len(set(labels))
    assert {"true walls", "detected walls", "true path", "estimated path", "start", "end"} <= set(labels)


def test_the_axes_contain_everything_drawn(trace: Trace) -> None:
    ax = Figure().add_subplot()
    draw_map(ax, trace)
    assert trace.scene is not None
    points = np.concatenate([trace.scene.walls.reshape(-1, 2), np.array(trace.odometry)[:, :2]])
    for low_high, values in ((ax.get_xlim(), points[:, 0]), (ax.get_ylim(), points[:, 1])):
        assert low_high[0] < values.min()
        assert low_high[1] > values.max()


def test_the_detected_walls_lie_on_the_true_ones(trace: Trace) -> None:
    assert trace.scene is not None
    found = walls_found(trace)
    assert len(found) >= 4
    off = [point_segment_distance(point, trace.scene.walls).min() for point in found.reshape(-1, 2)]
    assert np.mean(off) < 0.03


def test_a_run_without_returns_can_be_drawn(tmp_path: Path) -> None:
    blind = dataclasses.replace(preset(), scene="rectangle", max_time=0.5)
    blind = dataclasses.replace(blind, laser=dataclasses.replace(blind.laser, max_range=0.01))
    save_map(run(blind), tmp_path / "map.png", "a title")
    assert (tmp_path / "map.png").is_file()
