import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sixthsense.cli import main
from sixthsense.figures.animation import AnimationError, animate
from sixthsense.figures.animation import _CellImage as CellImage
from sixthsense.figures.run import load
from sixthsense.record.trace import Trace

needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one"
    assert main(["run", "rectangle", "--seed", "2", "--goal", "1.2", "0.5", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def ended(folder) -> Trace:
    return load(folder).trace


def test_a_film_has_the_given_number_of_frames_and_the_map_grows(folder, ended, tmp_path):
    shown: list[int] = []
    animate(folder, ended, tmp_path / "run.gif", "a run", frames=3, on_frame=lambda: shown.append(1))
    assert len(shown) == 3
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames == 3
        frames = []
        for k in range(3):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), dtype=np.int64))
    assert np.abs(frames[2] - frames[0]).max() > 50


@needs_ffmpeg
def test_a_film_is_written_as_mp4(folder, ended, tmp_path):
    animate(folder, ended, tmp_path / "deep" / "run.mp4", frames=2)
    assert [file.name for file in (tmp_path / "deep").iterdir()] == ["run.mp4"]
    assert (tmp_path / "deep" / "run.mp4").read_bytes()[4:8] == b"ftyp"


def test_an_mp4_without_ffmpeg_is_refused_before_anything_is_written(folder, ended, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(AnimationError, match="needs the program ffmpeg, which is not installed"):
        animate(folder, ended, tmp_path / "run.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(shutil.which("false") is None, reason="needs a program that fails")
def test_an_ffmpeg_that_fails_leaves_nothing_behind(folder, ended, tmp_path, monkeypatch):
    real = subprocess.Popen
    monkeypatch.setattr(shutil, "which", lambda _: "ffmpeg")
    monkeypatch.setattr(subprocess, "Popen", lambda words, **pipes: real(["false"], **pipes))
    with pytest.raises(AnimationError, match="ffmpeg cannot write"):
        animate(folder, ended, tmp_path / "run.mp4", frames=2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("args", "complaint"),
    [
        (["--animate", "film.avi"], "--animate: found 'film.avi', allowed: FILE.mp4 or FILE.gif"),
        (["--animate="], "--animate: found '', allowed: FILE.mp4 or FILE.gif"),
        (["--animate=film"], "--animate: found 'film', allowed: FILE.mp4 or FILE.gif"),
        (["{folder}", "--animate"], "--animate: found 2 runs, allowed: one run"),
    ],
)
def test_an_invalid_film_is_refused_in_one_line(folder, args, complaint, capsys):
    assert main(["report", str(folder), *(word.format(folder=folder) for word in args)]) == 2
    assert capsys.readouterr().err == f"sixthsense: {complaint}\n"
    assert not (folder / "figures" / "report.html").exists()


def test_a_folder_after_the_option_is_a_run(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sixthsense.figures.animation.MOST_FRAMES", 2)
    named = tmp_path / "run.two"
    shutil.copytree(folder, named)
    assert main(["report", "--animate", str(named)]) == 0
    assert (named / "figures" / "animation.gif").is_file()


def test_a_map_of_more_cells_than_pixels_keeps_its_thinnest_wall():
    cells = CellImage(np.zeros(2), np.array([100.0, 50.0]), 0.05)
    occupancy = np.full((1000, 2000), -1, dtype=np.int8)
    occupancy[:, :1000] = 0
    occupancy[:, 501] = 100
    image = cells.shades(occupancy, (0.0, 0.0))
    assert max(image.shape) <= 800
    assert set(image[:, : image.shape[1] // 2 - 1].ravel().tolist()) == {1, 2}
    assert (image == 2).any(axis=1).all()
    assert (image[:, image.shape[1] // 2 + 1 :] == 0).all()
    left, right, low, high = cells.extent
    assert (left, low) == (0.0, 0.0)
    assert right >= 100.0
    assert high >= 50.0


def test_cells_have_their_position_in_the_grid():
    cells = CellImage(np.array([-1.0, -0.5]), np.array([1.0, 0.5]), 0.1)
    occupancy = np.full((4, 4), -1, dtype=np.int8)
    occupancy[1, 2] = 100
    image = cells.shades(occupancy, (0.3, -0.2))  # the obstacle's corner is at (0.5, -0.1)
    (row,), (col,) = np.nonzero(image)
    left, _, low, _ = cells.extent
    assert left + 0.1 * col == pytest.approx(0.5)
    assert low + 0.1 * row == pytest.approx(-0.1)
