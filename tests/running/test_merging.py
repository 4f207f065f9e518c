"""Two runs in one building, mapped together."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense import cli

pytestmark = pytest.mark.usefixtures("compiled", "here")

TOUR = {"task": "tour", "max_time": 30.0, "progress": False}
OTHER = """\
start = [-3.0, -3.0, 0.0]
radius = 0.15
region = [-9.0, -9.0, 9.0, 9.0]
tour = [[5.0, -3.0], [5.0, 4.0], [-3.0, 5.0]]
[[polygons]]
points = [[-9.0, -7.0], [9.0, -7.0], [9.0, 8.0], [-7.5, 6.0]]
[[polygons]]
points = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5]]
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with two tours of the apartment from different starts, and one elsewhere."""
    folder = tmp_path_factory.mktemp("runs")
    ss.run("apartment", seed=1, out=folder / "monday", **TOUR)
    ss.run("apartment", seed=2, start=(11.5, 0.9, 1.5), out=folder / "tuesday", **TOUR)
    (folder / "other.toml").write_text(OTHER)
    ss.run(folder / "other.toml", seed=3, out=folder / "other", **TOUR)
    return folder


def complaint(args, capsys, here):
    assert cli.main(["merge", *map(str, args)]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if not line.startswith("looking for ")]
    assert out == "" and len(lines) == 1
    assert [entry.name for entry in here.iterdir() if entry.name != ".run.lock"] == []
    return lines[0].removeprefix("sixthsense: ")


def test_both_runs_are_in_one_frame_and_the_folder_is_that_of_a_run(runs, here, capsys):
    assert cli.main(["merge", str(runs / "monday"), str(runs / "tuesday"), "--out", "both"]) == cli.DONE
    assert "written to both/" in capsys.readouterr().out
    both, monday, tuesday = ss.load("both"), ss.load(runs / "monday"), ss.load(runs / "tuesday")
    assert len(both.trace.stamps_ns) == len(monday.trace.stamps_ns) + len(tuesday.trace.stamps_ns)
    assert both.trace.stamps_ns == sorted(both.trace.stamps_ns)
    driven = [run.metrics["path_length_m"] for run in (both, monday, tuesday)]
    assert driven[0] == pytest.approx(driven[1] + driven[2], abs=1e-6)
    assert both.trace.carried_scans() == [len(monday.trace.estimates)] and monday.trace.carried_scans() == []
    errors = np.array(both.trace.trajectory)[:, :2] - np.array(both.trace.key_truths)[:, :2]
    assert np.hypot(*errors.T).max() < 0.05
    again = ss.replay("both", progress=False)
    assert np.allclose(again.trace.trajectory, both.trace.trajectory, atol=1e-9)


def test_runs_of_two_buildings_are_not_merged(runs, here, capsys):
    line = complaint([runs / "monday", runs / "other", "--out", "both"], capsys, here)
    assert line.startswith(
        "other: found no place of monday that alone fits what was seen, allowed: two runs that share"
    )
