from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sixthsense.cli import main
from sixthsense.figures.animation import animate
from sixthsense.figures.run import load
from sixthsense.record.trace import Trace


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


@pytest.mark.parametrize(
    ("args", "complaint"),
    [
        (["--animate", "film.avi"], "--animate: found 'film.avi', allowed: FILE.mp4, FILE.webp or FILE.gif"),
        (["--animate="], "--animate: found '', allowed: FILE.mp4, FILE.webp or FILE.gif"),
        (["--animate=film"], "--animate: found 'film', allowed: FILE.mp4, FILE.webp or FILE.gif"),
        (["{folder}", "--animate"], "--animate: found 2 runs, allowed: one run"),
    ],
)
def test_an_invalid_film_is_refused_in_one_line(folder, args, complaint, capsys):
    assert main(["report", str(folder), *(word.format(folder=folder) for word in args)]) == 2
    assert capsys.readouterr().err == f"sixthsense: {complaint}\n"
    assert not (folder / "figures" / "report.html").exists()
