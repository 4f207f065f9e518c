"""Bags of ROS 1 and ROS 2, TUM files and folders of runs: the same poses have the same audit."""

import json

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.metrics import nees_world
from sixthsense.record.messages import Messages
from sixthsense.sources.logs.text_lines import read_tum

N = 400
STAMPS_NS = 1_700_000_000_000_000_000 + 100_000_000 * np.arange(N)
HEADING = 0.05 * np.arange(N)
TRUTH = np.column_stack([3.0 * np.sin(HEADING), -3.0 * np.cos(HEADING), HEADING])
COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4
POSES = TRUTH + np.random.default_rng(0).multivariate_normal(np.zeros(3), COV, N)
EXPECTED = float(nees_world(POSES - TRUTH, np.broadcast_to(COV, (N, 3, 3))).mean())

TYPES = {
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped", "/odom": "nav_msgs/msg/Odometry",
    "/truth": "geometry_msgs/msg/PoseStamped", "/tf": "tf2_msgs/msg/TFMessage",
}  # fmt: skip


def messages():
    """Topic, stamp and message: estimates as /pose and /odom, the truth as /truth and as map -> odom -> base in /tf."""
    make = Messages()
    away = Pose(1.0, 2.0, 0.3)
    for stamp, pose, truth in zip(STAMPS_NS.tolist(), POSES, TRUTH, strict=True):
        yield "/pose", stamp, make.estimate(stamp, Pose(*pose), COV)
        odometry = make.odometry(stamp, Pose(*pose), COV)
        odometry.header.frame_id, odometry.child_frame_id = "map", "base"
        yield "/odom", stamp, odometry
        yield "/truth", stamp, make.pose_stamped(stamp, Pose(*truth))
        yield "/tf", stamp, make.transform(stamp, "map", "odom", away)
        yield "/tf", stamp, make.transform(stamp, "odom", "base", away.inverse() @ Pose(*truth))


def bag(file, topics):
    """A ROS 2 bag with some of the topics."""
    make = Messages()
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channels = {}
        for topic in topics:
            text = make.store.generate_msgdef(TYPES[topic], ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(TYPES[topic], "ros2msg", text), {}
            )
        for topic, stamp, message in messages():
            if topic in topics:
                writer.add_message(channels[topic], stamp, make.serialized(message, TYPES[topic]), stamp)
        writer.finish()
    return file


def bag1(file, topic):
    """A ROS 1 bag with one topic of poses."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(file) as writer:
        connection = writer.add_connection(topic, TYPES[topic], typestore=store)
        for name, stamp, message in messages():
            if name == topic:
                old = as_type(store, message, TYPES[topic])
                writer.write(connection, stamp, store.serialize_ros1(old, TYPES[topic]))
    return file


def as_type(store, message, name):
    """The message with the classes of another store; ROS 1's header has a sequence number."""
    if name == "std_msgs/msg/Header":
        stamp = store.types["builtin_interfaces/msg/Time"](message.stamp.sec, message.stamp.nanosec)
        return store.types[name](0, stamp, message.frame_id)
    values = [getattr(message, field) for field, _ in store.fielddefs[name][1]]
    return store.types[name](
        *(as_type(store, value, value.__msgtype__) if hasattr(value, "__msgtype__") else value for value in values)
    )


def stamped(file, rows):
    """A file of numbers, a row per stamp."""
    stamps = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS_NS.tolist()]
    lines = [" ".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, rows, strict=True)]
    file.write_text("\n".join(["# a comment", *lines]) + "\n")
    return file


def tum(file, poses=TRUTH):
    half = 0.5 * poses[:, 2]
    return stamped(file, np.column_stack([poses[:, :2], np.zeros((N, 3)), np.sin(half), np.cos(half)]).tolist())


def covariances(file, size=3):
    cov = COV
    if size == 6:
        cov = np.zeros((6, 6))
        cov[np.ix_((0, 1, 5), (0, 1, 5))] = COV
    return stamped(file, [cov[np.triu_indices(size)].tolist()] * N)


def nees(*arguments, **options):
    return ss.audit(*arguments, **options).findings.nees


def complaint(capsys, *words):
    assert main(["audit", *map(str, words)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("sixthsense: ") and said.count("\n") == 1
    return said


@pytest.mark.parametrize("topic", ["/pose", "/odom"])
def test_a_bag_of_ros_2_is_read_in_its_convention_with_the_truth_from_any_source(topic, tmp_path):
    file = bag(tmp_path / "b.mcap", [topic, "/truth", "/tf"])
    assert nees(file, file, topic=topic, truth_topic="/truth") == pytest.approx(EXPECTED, rel=1e-9)
    assert nees(file, tum(tmp_path / "t.tum")) == pytest.approx(EXPECTED, rel=1e-9)
    frames = {} if topic == "/odom" else {"truth_frames": ("map", "base")}
    assert nees(file, file, truth_topic="/tf", **frames) == pytest.approx(EXPECTED, rel=1e-6)
    assert nees(file, (1e-9 * STAMPS_NS, TRUTH)) == pytest.approx(EXPECTED, rel=1e-3)
    first = repr(ss.audit(file, file, truth_topic="/truth")).splitlines()[0]
    assert "world's axes" in first and "the convention of ROS" in first


def test_a_bag_of_ros_1_has_the_same_audit(tmp_path):
    assert nees(bag1(tmp_path / "b.bag", "/pose"), tum(tmp_path / "t.tum")) == pytest.approx(EXPECTED, rel=1e-9)


@pytest.mark.parametrize("size", [3, 6])
def test_a_tum_file_has_its_covariances_beside_it(size, tmp_path):
    estimate, truth = tum(tmp_path / "e.tum", POSES), tum(tmp_path / "t.tum")
    assert nees(estimate, truth, covariance=covariances(tmp_path / "c.txt", size)) == pytest.approx(EXPECTED, rel=1e-9)


def test_the_folder_of_a_run_has_the_nees_of_its_metrics(tmp_path):
    run = ss.run("rectangle", task="tour", max_time=15.0, out=tmp_path / "run")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    folder, recorded = str(tmp_path / "run"), tmp_path / "run" / "bag"
    for found in (
        ss.audit(run), ss.audit(folder), ss.audit(folder, folder),
        ss.audit(recorded, recorded, topic="/estimate", truth_topic="/truth"),
        ss.audit(recorded, folder, topic="/estimate"),
    ):  # fmt: skip
        assert found.findings.nees == pytest.approx(metrics["pose_nees_world_mean"], abs=1e-9)
        assert found.findings.samples <= metrics["pose_nees_effective_samples"] + 1e-9


def test_the_command_prints_writes_and_draws_and_may_require_consistency(tmp_path, capsys):
    file = bag(tmp_path / "b.mcap", ["/pose"])
    words = [str(file), "--truth", str(tum(tmp_path / "t.tum"))]
    out = ["--json", str(tmp_path / "a.json"), "--figure", str(tmp_path / "a.png")]
    assert main(["audit", *words, *out]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("covariance   in the world's axes")
    assert any(line.startswith("verdict      consistent: errors are") for line in lines)
    assert json.loads((tmp_path / "a.json").read_text())["outcome"] == "consistent"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(["audit", *words, "--require", "consistent", *out, "--overwrite"]) == 0
    larger = tum(tmp_path / "e.tum", TRUTH + 2.0 * (POSES - TRUTH))
    wrong = [str(larger), *words[1:], "--covariance", str(covariances(tmp_path / "c"))]
    assert main(["audit", *wrong]) == 0
    assert main(["audit", *wrong, "--require", "consistent"]) == 1
    assert "overconfident: errors are" in capsys.readouterr().out
    assert "--json: " in complaint(capsys, *words, *out)


def test_a_trajectory_in_nanoseconds_is_read_as_that_with_a_note(tmp_path):
    rows = [line.split() for line in tum(tmp_path / "s.tum").read_text().splitlines() if line[:1] not in ("", "#")]
    lines = [" ".join([str(ns), *row[1:]]) for ns, row in zip(STAMPS_NS.tolist(), rows, strict=True)]
    (tmp_path / "ns.tum").write_text("\n".join(lines) + "\n")
    notes: list[str] = []
    stamps, poses = read_tum(tmp_path / "ns.tum", notes)
    assert np.array_equal(stamps, STAMPS_NS) and np.array_equal(poses, read_tum(tmp_path / "s.tum")[1])
    assert len(notes) == 1 and "are taken as nanoseconds" in notes[0]
