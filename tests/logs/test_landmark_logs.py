"""Logs of landmarks with known ids: graphs in text formats, and the folders of MRCLAM."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.logs.graph import read_graph
from sixthsense.logs.log import Log

MOTION = "ODOMETRY {} {} 1.0 0.1 0.2 1e-4 0 0 1e-4 0 1e-4\n"


def graph(text: str, folder: Path, name: str = "some.graph") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def test_landmark_tags_differ_in_the_meaning_of_their_numbers(tmp_path):
    cov = np.array([[0.3, 0.1], [0.1, 0.2]])
    (xx, xy), (_, yy) = np.linalg.inv(cov).tolist()
    lines = [
        "LANDMARK 1 10 3.0 4.0 0.3 0.1 0.2\n",
        f"EDGE_SE2_XY 1 11 3.0 4.0 {xx!r} {xy!r} {yy!r}\n",
        f"BR 1 12 {math.atan2(4.0, 3.0)!r} 5.0 0.02 0.1\n",
    ]
    seen = read_graph(graph(MOTION.format(0, 1) + "".join(lines), tmp_path)).ticks[1].observations
    assert list(seen) == [10, 11, 12]
    assert all(s.z == pytest.approx(np.array([3.0, 4.0]), abs=2e-3) for s in seen.values())
    assert seen[10].cov == pytest.approx(cov) and seen[11].cov == pytest.approx(cov)
    bearing, distance, polar = seen[12].bearing_range()
    assert (bearing, distance) == pytest.approx((math.atan2(4.0, 3.0), 5.0), abs=1e-6)
    assert polar == pytest.approx(np.diag([4e-4, 0.01]), rel=1e-3, abs=1e-9)


def victoria_park() -> Log:
    spec = importlib.util.find_spec("gtsam")
    assert spec is not None and spec.origin is not None
    return read_graph(Path(spec.origin).parent / "Data" / "victoria_park.txt")


def test_victoria_park_has_its_published_size():
    log = victoria_park()
    ids = [i for tick in log.ticks for i in tick.observations]
    assert (len(log.ticks), len(ids), len(set(ids))) == (6969, 3640, 151)


def test_edges_to_earlier_poses_are_loop_closures_either_way_and_stay_in_the_run_folder(tmp_path):
    """A round of 12 poses whose odometry is turned too far; closures with the first poses, one of them reversed."""
    step, wrong = Pose(0.8, 0.1, 2.0 * math.pi / 12), Pose(0.8, 0.1, 2.0 * math.pi / 12 + 0.02)
    true = [Pose()]
    for _ in range(12):
        true.append(true[-1] @ step)
    lines, upper = [], "2e3 3e2 0 4e3 0 9e3"
    for k in range(12):
        lines.append(f"EDGE_SE2 {k} {k + 1} {' '.join(map(repr, wrong.array().tolist()))} 1e3 0 0 1e3 0 1e3\n")
    for i, j in ((11, 1), (0, 12), (12, 2)):
        seen = " ".join(map(repr, (true[i].inverse() @ true[j]).array().tolist()))
        lines.append(f"EDGE_SE2 {i} {j} {seen} {upper}\n")
    file = graph("".join(lines), tmp_path, "round.g2o")
    log = read_graph(file)
    assert [len(tick.closures) for tick in log.ticks] == [0] * 11 + [1, 2]
    one, other = log.ticks[11].closures[0], log.ticks[12].closures[0]
    assert one.before == 1 and one.motion.array() == pytest.approx((true[1].inverse() @ true[11]).array())
    assert other.before == 0
    run = ss.replay(file, progress=False, out=tmp_path / "out", estimator="isam2")
    off = [np.hypot(*(pose[:2] - at.position)) for pose, at in zip(run.trace.trajectory, true, strict=True)]
    alone = [np.hypot(*(tick.odometry.position - at.position)) for tick, at in zip(log.ticks, true, strict=True)]
    assert max(alone) > 0.3 and max(off) < 0.1 * max(alone)
    again = ss.replay(tmp_path / "out", progress=False)
    assert again.trace.trajectory == pytest.approx(run.trace.trajectory, abs=1e-12)
    assert "found an edge from pose 3 to 9, allowed: from the newest pose, 2" in refused(tmp_path)


def refused(folder):
    """What is said of an edge to a pose that no way leads to."""
    with pytest.raises(InputError) as caught:
        read_graph(graph(MOTION.format(0, 1) + MOTION.format(1, 2) + MOTION.format(3, 9), folder, "bad.graph"))
    return str(caught.value)


def test_the_covariance_of_a_reversed_edge_is_that_of_its_samples(tmp_path):
    """Draws of the edge's error, in the axes of its end, as errors of the motion the other way in those of its end."""
    rng, cov = np.random.default_rng(4), np.array([[4.0, 1.0, 0.3], [1.0, 2.0, -0.4], [0.3, -0.4, 1.0]]) * 1e-4
    step, upper = Pose(1.7, -0.6, 0.8), " ".join(map(repr, np.linalg.inv(cov)[np.triu_indices(3)].tolist()))
    text = (
        MOTION.format(0, 1)
        + MOTION.format(1, 2)
        + f"EDGE_SE2 2 0 {' '.join(map(repr, step.array().tolist()))} {upper}\n"
    )
    closure = read_graph(graph(text, tmp_path, "back.g2o")).ticks[2].closures[0]
    draws = rng.multivariate_normal(np.zeros(3), cov, 20000)
    back = np.array([(step @ (step @ Pose(*draw)).inverse()).array() for draw in draws])  # beyond the motion back
    assert np.abs(closure.cov - np.cov(back.T)).max() < 0.05 * np.abs(closure.cov).max()
