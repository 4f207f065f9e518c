import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.evaluation.measure import measure
from sixthsense.loop import replay, run
from sixthsense.record.bag import BagWriter
from sixthsense.record.message_form import ArrayForm, MessageForm, quaternion
from sixthsense.record.trace import Trace
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.runfolder import read_run

CONFIG = preset(task="tour", scene="rectangle", max_time=12.0, laser={"mount": [0.1, -0.05, 0.3], "max_range": 7.3})


class Kept:
    """Every tick that the loop has seen."""

    def __init__(self) -> None:
        self.ticks: list[Tick] = []

    def __call__(self, tick: Tick, trace: Trace) -> None:
        self.ticks.append(tick)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Tick], Trace]:
    folder, kept = tmp_path_factory.mktemp("run"), Kept()
    with BagWriter(folder) as bag:
        trace = run(CONFIG, lambda tick, trace: (bag(tick, trace), kept(tick, trace))[0])
    return folder, kept.ticks, trace


def expected_counts(ticks: list[Tick], trace: Trace) -> dict[str, int]:
    return {
        "/tf_static": 1,
        "/odom": len(ticks),
        "/truth": len(ticks),
        "/scan": len(trace.stamps_ns),
        "/estimate": len(trace.key_estimates),
        "/plan": len(trace.plans),
    }


def test_the_metadata_names_topics_times_and_the_file(recorded):
    folder, ticks, trace = recorded
    table = yaml.safe_load((folder / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert table["storage_identifier"] == "mcap" and table["relative_file_paths"] == ["bag_0.mcap"]
    assert table["duration"]["nanoseconds"] == ticks[-1].stamp_ns
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in table["topics_with_message_count"]}
    assert counts == expected_counts(ticks, trace) and table["message_count"] == sum(counts.values())


def test_a_filled_form_is_the_message_with_its_numbers():
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    time, header, point = (store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header",
                                                          "geometry_msgs/msg/Point"))  # fmt: skip

    def serialized(stamp, x, y):
        message = store.types["geometry_msgs/msg/PointStamped"](header(time(*stamp), "odom"), point(x, y, 3.0))
        return bytes(store.serialize_cdr(message, "geometry_msgs/msg/PointStamped"))

    form = MessageForm(2, lambda numbers: serialized((0, 0), *numbers))
    for stamp, x, y in (((0, 0), 0.0, -0.0), ((2**31 - 1, 999_999_999), math.pi, math.inf), ((7, 5), 1e-300, -2.5)):
        assert form.fill(*stamp, (x, y)) == serialized(stamp, x, y)


@pytest.mark.parametrize("beams", [0, 1, 181])
def test_a_form_of_scans_gives_the_bytes_of_a_message(beams):
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]

    def serialized(stamp, ranges):
        content = (-1.5, 1.5, 0.01, 0.0, 0, 0, 30.0, ranges, np.zeros(0, dtype=np.float32))
        message = store.types["sensor_msgs/msg/LaserScan"](header(time(*stamp), "laser"), *content)
        return bytes(store.serialize_cdr(message, "sensor_msgs/msg/LaserScan"))

    form = ArrayForm(beams, lambda ranges: serialized((0, 0), ranges))
    for stamp in ((0, 0), (2**31 - 1, 999_999_999)):
        ranges = np.linspace(0.0, 40.0, beams, dtype=np.float32)
        ranges[::3] = np.inf
        assert form.fill(*stamp, ranges) == serialized(stamp, ranges)


def test_messages_say_what_the_run_believed_and_planned(recorded):
    from rosbags.highlevel import AnyReader

    folder, _, trace = recorded
    estimates, plans = [], []
    with AnyReader([folder / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/estimate":
                estimates.append(message)
            elif connection.topic == "/plan":
                plans.append(message)
    for message, estimate in zip(estimates, trace.key_estimates, strict=True):
        cov = message.pose.covariance.reshape(6, 6)
        assert np.array_equal(cov[np.ix_((0, 1, 5), (0, 1, 5))], estimate.pose_cov)
        assert np.count_nonzero(cov) == np.count_nonzero(estimate.pose_cov)
        assert (message.pose.pose.position.x, message.pose.pose.position.y) == (estimate.pose.x, estimate.pose.y)
    for message, plan in zip(plans, trace.plans, strict=True):
        assert [(p.pose.position.x, p.pose.position.y) for p in message.poses] == [tuple(p) for p in plan.tolist()]


def test_every_tick_comes_back_to_the_bit(recorded):
    folder, ticks, trace = recorded
    log = read_run(folder, CONFIG.laser)
    assert not log.cut_short
    for ours, back in zip(ticks, log.ticks, strict=True):
        assert (back.stamp_ns, back.odometry, back.truth) == (ours.stamp_ns, ours.odometry, ours.truth)
        assert (back.scan is None) == (ours.scan is None)
        if ours.scan is not None and back.scan is not None:
            assert back.scan.ranges.tobytes() == ours.scan.ranges.tobytes() and back.scan.ranges.dtype == np.float32
            assert back.scan.angle_min == ours.scan.angle_min
            assert back.scan.angle_increment == ours.scan.angle_increment
            assert (back.scan.max_range, back.scan.T_robot_laser) == (ours.scan.max_range, ours.scan.T_robot_laser)
    assert all(np.array_equal(a, b) for a, b in zip(log.plans, trace.plans, strict=True))


def test_a_run_replays_to_the_same_estimates_covariances_and_errors(recorded):
    folder, _, trace = recorded
    again = replay(read_run(folder, CONFIG.laser), CONFIG)
    assert np.array_equal(np.array(again.estimates), np.array(trace.estimates))
    assert np.array_equal(again.joint_cov, trace.joint_cov)
    figures, before = measure(again), measure(trace)
    driving = ("outcome", "plans", "plans_below_margin", "guard_stops")
    steady = [key for key in before if "_ms_" not in key and "time" not in key and key not in driving]
    assert {key: figures[key] for key in steady} == {key: before[key] for key in steady}


@pytest.mark.parametrize("name", ["default", "report"])
@pytest.mark.parametrize("seed", range(3))
def test_replay_is_exact_over_presets_and_seeds(name, seed, tmp_path):
    config = preset(name, task="tour", max_time=25.0, seed=seed)
    with BagWriter(tmp_path) as bag:
        trace = run(config, bag)
    again = replay(read_run(tmp_path, config.laser), config)
    assert len(again.key_stamps_ns) == len(trace.key_stamps_ns) > 3
    assert np.array_equal(np.array(again.estimates), np.array(trace.estimates))


def test_a_log_keeps_its_own_stamps_beside_the_clock(tmp_path):
    """They differ where a log's clock runs backwards, and relations name scans by them."""
    laser = LaserConfig(beams=4)
    scan = Scan.from_config(np.array([1.0, 2.0, np.inf, 3.0]), laser)
    own = [976052857.33772, 976052857.12, 976052858.0, 3e9]
    clock = [976052857337720000, 976052857337720001, 976052858000000000, 3 * 10**18]
    ticks = [Tick(c, Pose(k, 0, 0), scan, log_stamp_s=s) for k, (c, s) in enumerate(zip(clock, own, strict=True))]
    with BagWriter(tmp_path) as bag:
        replay(Log(ticks), preset("log", laser={"beams": 4}), None, bag)
    log = read_run(tmp_path, laser)
    assert [tick.stamp_ns for tick in log.ticks] == clock
    assert [tick.log_stamp_s for tick in log.ticks][:3] == own[:3]  # the fourth is beyond what ROS can count
    assert log.backward_stamps == 1


def test_headings_survive_the_quaternion_to_the_last_bit():
    rng = np.random.default_rng(0)
    near = 10.0 ** rng.uniform(-300, 0, 5000)
    headings = np.concatenate([rng.uniform(-math.pi, math.pi, 50_000), near, -near, near - math.pi, [0.0, -math.pi]])
    headings = np.append(headings[headings < math.pi], np.nextafter(math.pi, 0.0))
    for theta in headings.tolist():
        z, w = quaternion(theta)
        assert 2.0 * math.atan2(z, w) == theta
        assert math.hypot(z, w) == pytest.approx(1.0, abs=1e-15)


def test_an_interrupted_run_has_a_whole_bag(tmp_path):
    class EnoughError(Exception):
        pass

    def stop(tick, trace):
        bag(tick, trace)
        if tick.stamp_ns >= 2_000_000_000:
            raise EnoughError

    with pytest.raises(EnoughError), BagWriter(tmp_path) as bag:
        run(CONFIG, stop)
    log = read_run(tmp_path, CONFIG.laser)
    assert not log.cut_short and log.ticks[-1].stamp_ns == 2_000_000_000
