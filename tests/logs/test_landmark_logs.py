"""Logs of landmarks with known ids: graphs in text formats, and the folders of MRCLAM."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.config import AssumedConfig, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.logs import open_log
from sixthsense.logs.graph import read_graph
from sixthsense.logs.log import Log
from sixthsense.loop.run import replay

CIRCLED = {1000: (3.0, 1.0), 1001: (0.0, 4.0), 1002: (-2.0, 2.0), 1003: (1.0, -2.0)}
MOTION = "ODOMETRY {} {} 1.0 0.1 0.2 1e-4 0 0 1e-4 0 1e-4\n"
BARCODES = {1: 5, 2: 14, 6: 63, 7: 81, 8: 7}
PLACES = {6: (4.0, 0.5), 7: (4.5, -0.5), 8: (5.0, 1.5)}
START = Pose(1.0, 0.2, 0.1)
SPEED, TURN_RATE = 0.2, 0.05


def graph(text: str, folder: Path, name: str = "some.graph") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def drive(poses: int = 30, order: int = 1) -> str:
    """A round of a circle past four landmarks, without noise; those of one pose in the order asked."""
    step, lines, pose = Pose(0.5, 0.05, 0.2), [], Pose()
    for k in range(poses):
        if k:
            x, y, turn = step.array().tolist()
            lines.append(f"ODOMETRY {k - 1} {k} {x!r} {y!r} {turn!r} 1e-4 0 0 4e-5 0 1e-4\n")
            pose = pose @ step
        for i, place in list(CIRCLED.items())[::order]:
            x, y = (pose.inverse() @ np.array(place)).tolist()
            if math.hypot(x, y) < 4.0:
                lines.append(f"LANDMARK {k} {i} {x!r} {y!r} 0.01 0.001 0.02\n")
    return "".join(lines)


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


def rows(*values: object) -> str:
    return "# a head\n" + "".join(" ".join(map(str, row)) + "\n" for row in values)


def driven(seconds: float) -> Pose:
    """Where the robot truly is; it drives an arc."""
    turn = TURN_RATE * seconds
    radius = SPEED / TURN_RATE
    return START @ Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)


def folder(path: Path, robot: int = 3, steps: int = 40, order: int = 1) -> Path:
    """A small MRCLAM folder without noise; a measurement every half second, its landmarks in the order asked."""
    path.mkdir(exist_ok=True)
    times = [1000.0 + 0.1 * k for k in range(steps)]
    (path / "Barcodes.dat").write_text(rows(*BARCODES.items()))
    (path / "Landmark_Groundtruth.dat").write_text(rows(*((i, x, y, 0.0, 0.0) for i, (x, y) in PLACES.items())))
    (path / f"Robot{robot}_Odometry.dat").write_text(rows(*((f"{t:.3f}", SPEED, TURN_RATE) for t in times)))
    truth = rows(*((f"{t:.3f}", *driven(t - 1000.0).array()) for t in (*times, times[-1] + 0.1)))
    (path / f"Robot{robot}_Groundtruth.dat").write_text(truth)
    seen = []
    for t in [1000.25 + 0.5 * k for k in range(steps // 5 - 1)]:
        pose = driven(t - 1000.0)
        for i, place in list(PLACES.items())[::order]:
            x, y = pose.inverse() @ np.array(place)
            if x < 0.5 or abs(y) > 2.0 * x:
                continue
            seen.append((f"{t:.3f}", BARCODES[i], x, math.atan2(y, x)))
        seen.append((f"{t:.3f}", BARCODES[1], 2.0, 0.1))
    (path / f"Robot{robot}_Measurement.dat").write_text(rows(*seen))
    return path


def both_orders(folder_: Path, kind: str) -> tuple[Path, Path]:
    """The same log twice, with the observations of a pose in opposite orders."""
    if kind == "victoria":
        return graph(drive(), folder_, "a.txt"), graph(drive(order=-1), folder_, "b.txt")
    return folder(folder_ / "a"), folder(folder_ / "b", order=-1)


@pytest.mark.parametrize("estimator", ["ekf", "ekf-invariant", "isam2"])
@pytest.mark.parametrize("kind", ["victoria", "mrclam"])
def test_a_replay_is_reproducible_for_any_order_of_observations(tmp_path, kind, estimator):
    config = preset(kind, estimator=estimator)
    log, turned = map(open_log, both_orders(tmp_path, kind))
    first, again, other = (replay(source, config) for source in (log, log, turned))
    assert np.array_equal(first.joint_cov, again.joint_cov)
    assert np.array_equal(np.array(first.estimates), np.array(again.estimates))
    assert np.array(other.estimates) == pytest.approx(np.array(first.estimates), abs=1e-6)
    assert len(first.estimates) > 5 and set(first.final.ids.tolist()) == set(CIRCLED if kind == "victoria" else PLACES)
    truth = [tick.truth or tick.odometry for tick in log.ticks if tick.observations is not None]
    # The smoother takes out of a range what noise would have added, and these have none.
    off = np.array(first.estimates) - np.array([pose.array() for pose in truth])
    assert np.abs(off).max() < 0.01


def test_a_mrclam_folder_is_refused_without_the_robot_that_is_wanted_one_of_several_named_or_noise(tmp_path):
    assumed = merge(AssumedConfig(), {"laser": {"range_m": 0.0}})
    for given, said in (({"robot": 7}, "found robots 3, allowed: one"), ({"assumed": assumed}, "range_m 0, allo")):
        with pytest.raises(InputError, match=said):
            open_log(folder(tmp_path / "a"), **given)
    with pytest.raises(InputError, match="found robots 3, 4, allowed: one, by `robot` N"):
        open_log(folder(tmp_path / "a", robot=4))
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match="found no RobotN_Odometry"):
        open_log(graph("3 13\n", tmp_path / "b", "Barcodes.dat").parent)


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
