"""Runs that are right are told good, and wrong ones not, with their cause."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from driven import config, kidnapped, mirrored, mount_left, replayed, ticks

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.figures.run import Run
from sixthsense.logs.log import Log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the runs `right` and `wrong`."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def right(folder: Path) -> Run:
    return ss.replay(Log(ticks()), config(), out=folder / "right", progress=False)


@pytest.fixture(scope="module")
def wrong(folder: Path) -> Run:
    return ss.replay(Log(mirrored()), config(), out=folder / "wrong", progress=False)


def test_a_right_map_is_told_good(right: Run) -> None:
    verdict = right.verdict
    assert verdict is not None and verdict.level == "good" and verdict.causes == () and verdict.cause == ""
    assert str(verdict) == "good" and verdict.probability < 0.1
    assert len(verdict.keyframes) == len(right.trace.trajectory) and verdict.keyframes.max() < 0.2
    assert right.metrics["verdict"] == "good" and right.metrics["map_wrong_probability"] == verdict.probability


def test_a_right_map_of_landmarks_is_told_good() -> None:
    verdict = replayed(ticks(), front_end="landmarks", estimator="isam2").verdict
    assert verdict is not None and verdict.level == "good", verdict


@pytest.mark.parametrize("front_end", ["scan-matching", "landmarks"])
def test_a_mirrored_laser_is_told_with_the_time_in_which_the_robot_turns(front_end: str, wrong: Run) -> None:
    run = wrong if front_end == "scan-matching" else replayed(mirrored(), front_end=front_end)
    verdict, duration_s = run.verdict, 1e-9 * (ticks()[-1].stamp_ns - ticks()[0].stamp_ns)
    assert verdict is not None and verdict.level == "broken" and verdict.cause == "mirrored"
    begin, end = map(int, re.findall(r"from (\d+) to (\d+) s; is the laser mirrored\?", str(verdict))[0])
    assert 0 <= begin < 0.2 * duration_s and 0.8 * duration_s < end <= duration_s + 1.0


def test_a_mount_that_is_stated_wrongly_is_told_with_where_the_laser_is_and_by_an_audit_too() -> None:
    run = replayed(mount_left())
    verdict = run.verdict
    assert verdict is not None and verdict.level != "good" and verdict.cause == "mount"
    told = re.search(r"([+-][\d.]+) m to the left", str(verdict))
    assert told is not None and float(told[1]) == pytest.approx(0.31, abs=0.03)
    named, scan = re.search(r"`laser.mount` (\S+) (\S+) [^)]+\)", str(verdict)), ticks()[0].scan
    assert named is not None and scan is not None
    assert np.array(named.groups(), dtype=float) == pytest.approx(scan.T_robot_laser.position, abs=0.03)
    truth = [1e-9 * tick.stamp_ns for tick in ticks()], [tick.odometry.array() for tick in ticks()]
    assert verdict.causes[0].sentence in ss.audit(run, truth).notes


def test_a_robot_that_was_carried_is_told_with_the_time() -> None:
    own, at_s = kidnapped()
    run = replayed(own)
    verdict = run.verdict
    assert verdict is not None and verdict.level != "good" and verdict.cause in ("carried", "slip")
    assert verdict.causes[0].from_s == pytest.approx(at_s, abs=1.5)
    scans = (np.array(run.trace.stamps_ns) - run.trace.stamps_ns[0]) * 1e-9
    place = run.trace.scan_poses()[np.searchsorted(scans, at_s), :2]
    assert math.dist(verdict.causes[0].places[0], place) < 1.5


def test_a_run_is_not_merged_with_a_mirrored_one_and_the_cause_is_told(right: Run, wrong: Run) -> None:
    with pytest.raises(InputError, match=r"wrong: found a map that is broken: .*is the laser mirrored\?"):
        ss.merge_runs(right.folder, wrong.folder, progress=False)


CARMEN = (
    "FLASER {count} {ranges} {x:.6f} {y:.6f} {theta:.6f} {x:.6f} {y:.6f} {theta:.6f} {stamp:.3f} host {stamp:.3f}\n"
)


@pytest.mark.parametrize("is_told", [True, False])
def test_a_log_of_a_mirrored_laser_is_mapped_as_the_robot_drove_where_the_option_says_so(tmp_path, is_told):
    """The scans of a laser at the robot's middle, written from right to left as CARMEN's are from left to right."""
    file, start = tmp_path / "m.clf", ticks()[0].odometry
    with file.open("w") as out:
        for tick in ticks()[::2]:
            scan = tick.scan
            half = np.abs(scan.bearings) <= math.pi / 2.0
            own = np.where(np.isfinite(scan.ranges), scan.ranges, 81.83)[half][::-1]
            place = {"x": tick.odometry.x, "y": tick.odometry.y, "theta": tick.odometry.theta}
            ranges = " ".join(f"{r:.3f}" for r in own)
            out.write(CARMEN.format(count=len(own), ranges=ranges, stamp=1e-9 * tick.stamp_ns, **place))
    laser = {"beams": int(half.sum()), "fov": float(np.ptp(scan.bearings[half])), "mirrored": is_told}
    run = ss.replay(file, laser=laser, progress=False)
    cause = "" if run.verdict is None else run.verdict.cause
    assert (cause == "mirrored") != is_told and run.trace.estimates[0] == pytest.approx(start.array(), abs=1e-5)


def test_a_simulated_laser_is_not_mirrored():
    with pytest.raises(InputError, match=r"laser\.mirrored: found on a simulated robot"):
        ss.run("rectangle", laser={"mirrored": True}, progress=False)


def test_a_verdict_comes_back_from_the_folder_of_its_run(wrong: Run) -> None:
    found, again = wrong.verdict, ss.load(wrong.folder).verdict
    assert found is not None and again is not None and again.probability == found.probability
    assert (again.level, again.cause, again.evidence) == (found.level, found.cause, found.evidence)
    assert again.keyframes == pytest.approx(found.keyframes, abs=1e-6)
