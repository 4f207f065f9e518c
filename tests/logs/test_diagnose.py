"""What is odd in a log is found with its cause, and what is right is not."""

import lzma
import math

import numpy as np
import pytest
from robot_bag import MOUNT, T0_NS, changed, read, robot_bag, way

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import between, compose
from sixthsense.logs import open_log
from sixthsense.logs.diagnose import beside_wheels, findings_of, hand_eye, settled
from sixthsense.logs.finding import KINDS, Finding

NOISE = np.array([0.02, 0.02, 0.005])


def turned(k):
    """Wheels that report their turns with the wrong sign."""
    pose = way(0.02 * k)
    return Pose(pose.x, -pose.y, -pose.theta)


# name: keywords of the bag, the kind that is found
FOUND = {
    "ranges from right to left": ({"scan": changed("is_mirrored", True)}, "turned_around"),
    "turns inverted": ({"odom": changed("pose", turned)}, "turned_around"),
    "odometry frozen": ({"odom": changed("pose", Pose(0.3, 0.2, 0.1))}, "frozen_odometry"),
    "sweep in ms": ({"scan": changed("lag", 0.35)}, "sweep"),
    "sweep negative": ({"scan": changed("lag", -0.0003)}, "sweep"),
    "sweep too small": ({"scan": changed("lag", 0.00002)}, "sweep"),
    "half the beams' angle": ({"scan": changed("angle_unit", 0.5)}, "turns_scaled"),
    "angle_max of twice the beams": (
        {"scan": changed("last", -2.0 + 2.0 * math.radians(1.2) * 239)},
        "angle_increment",
    ),
}


@pytest.mark.parametrize("name", FOUND)
def test_what_is_odd_is_found_with_its_cause(name, tmp_path):
    how, kind = FOUND[name]
    log, found = read(robot_bag(tmp_path / "bag", **how))
    assert found.keys() == ({kind} - {""})
    assert kind != "frozen_odometry" or not log.has_odometry


def driven(of_pose):
    """Odometry of a robot that drives along its heading, to either side, as `of_pose` of its pose has it."""
    poses = [Pose(0.4, -0.3, 0.3)]
    for k in range(300):
        poses.append(poses[-1] @ Pose(0.02, 0.0, 0.025 * math.sin(0.05 * k)))
    return changed("pose", lambda k: of_pose(poses[k]))


# name: odometry in place of x, y, heading; the kind
WHEELS = {
    "as it is": (lambda p: p, None),
    "x and y exchanged": (lambda p: Pose(p.y, p.x, p.theta), "axes_exchanged"),
    "headings in degrees": (lambda p: Pose(p.x, p.y, math.degrees(p.theta)), "headings_unit"),
    "to all sides": (lambda p: Pose(p.x, p.y, p.theta + 1.2), None),
    "sideways, nearly straight": (lambda p: Pose(p.x, 0.1 * p.y, 0.05 * p.theta + 1.4), None),
}


@pytest.mark.parametrize("name", WHEELS)
def test_odometry_along_whose_headings_no_robot_drives_is_named(name, tmp_path):
    of_pose, kind = WHEELS[name]
    log = open_log(robot_bag(tmp_path / "bag", odom=driven(of_pose)))
    kinds = {finding.kind for finding in findings_of(log.sightings, log.odometry)}
    assert kinds & {kind for _, kind in WHEELS.values()} == ({kind} - {None})
    if kind is not None:
        with pytest.raises(InputError, match="along"):
            settled(log, preset("log"))


@pytest.mark.parametrize(("begin_ns", "restart"), [(0, False), (T0_NS, True)])
def test_a_clock_that_begins_with_0_keeps_its_stamps_and_one_that_begins_anew_is_told(begin_ns, restart, tmp_path):
    def stamped(k, says):
        passed = says["stamp_ns"] - T0_NS
        return {**says, "stamp_ns": begin_ns + passed - (3_000_000_000 if restart and passed >= 3_000_000_000 else 0)}

    log, found = read(robot_bag(tmp_path / "bag", scan=stamped, odom=stamped))
    assert found.keys() == ({"stamps_of_recording", "stamps"} if restart else set())
    assert log.ticks[0].stamp_ns == (T0_NS if restart else 0) and log.duration_s == pytest.approx(5.98)


def motions(count, rng, is_circle):
    """Motions of a robot, (N, 3): on one circle, or to either side."""
    turns = np.full(count, 0.1) if is_circle else 0.4 * np.sin(0.9 * np.arange(count))
    return np.column_stack([np.full(count, 0.5), np.zeros(count), turns]) + NOISE * rng.normal(size=(count, 3))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("off", "scale", "kinds"), [
    ((0.0, 0.0, 0.0), 1.0, set()), ((0.3, -0.2, 0.0), 1.0, {"mount"}), ((-0.25, 0.02, -3.09), 1.0, {"mount"}),
    ((0.0, 0.0, 0.0), 0.5, {"odometry_scale"}), ((0.0, 0.0, 0.0), -1.0, {"wheels_reversed"}),
])  # fmt: skip
def test_mount_scale_and_sign_of_wheels_are_named_beside_a_path_and_left_open_on_one_circle(seed, off, scale, kinds):
    for is_circle in (False, True):
        true = motions(80, np.random.default_rng(seed), is_circle)
        T_off = np.broadcast_to(off, true.shape)
        path = between(T_off, compose(true, T_off)) + NOISE * np.random.default_rng(seed + 9).normal(size=true.shape)
        found = hand_eye(true / (scale, scale, 1.0), path, np.full(80, 0.05))
        if is_circle:
            assert found is None
            continue
        assert found is not None
        findings = {each.kind: each for each in beside_wheels(found, MOUNT)}
        assert findings.keys() == kinds
        if "mount" in kinds:
            fits = (Pose(*off) @ MOUNT).array()
            assert np.abs(findings["mount"].vector[:2] - fits[:2]).max() < 0.06
            assert math.remainder(findings["mount"].vector[2] - fits[2], 2.0 * math.pi) == pytest.approx(0.0, abs=0.05)


def test_every_kind_has_a_line_and_the_option_that_sets_it():
    config = preset("log")
    for kind, (action, _, option) in KINDS.items():
        line = str(Finding(kind, 1.5, 0.1, "here", (0.1, 0.2, 0.3)))
        assert line and "\n" not in line and (action == "refused" or not option or f"`{option}" in line)
        if action == "applied":
            section, _, name = option.rpartition(".")
            assert hasattr(getattr(config, section) if section else config, name)


def test_a_vertex_that_is_fixed_is_no_error_and_text_that_is_far_larger_than_its_file_is_one(tmp_path, monkeypatch):
    edges = "FIX 3\n" + "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0.1 9 0 0 9 0 9\n" for k in range(3, 7))
    (tmp_path / "a.g2o").write_text(edges)
    assert len(open_log(tmp_path / "a.g2o").ticks) == 5
    monkeypatch.setattr("sixthsense.logs.text_lines._BASE_BUDGET", 1 << 16)
    (tmp_path / "b.log.xz").write_bytes(lzma.compress(b"ODOM 0 0 0 0 0 0 1 h 1\n" * 8_000))
    with pytest.raises(InputError, match="far more text"):
        open_log(tmp_path / "b.log.xz")
