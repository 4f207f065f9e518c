"""What a run's folder and bag hold is what was put there, for general poses, shapes and covariances."""

import csv
import dataclasses
import itertools
import json
import math
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from rosbags.highlevel import AnyReader
from traces import CONFIG, RADIUS_M, cov_of, observation_of, pose_of, trace_of, written

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan, sweep_times
from sixthsense.core.source import Closure, Tick
from sixthsense.logs.runfolder import read_run
from sixthsense.record.bag import BagWriter
from sixthsense.record.columns import END, Column
from sixthsense.record.messages import Messages
from sixthsense.record.store import load_record
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate

NOT_KEPT = {"config", "live", "tours", "grid", "name", "prior_map"}
"""fields of a trace that the record does not have, or that are compared below"""

COV_COLUMNS = ("cov_xx", "cov_xy", "cov_yy"), ("cov_alpha_alpha", "cov_alpha_d", "cov_d_d")
"""of a point, and of a wall"""

few = settings(max_examples=8)
rngs = st.integers(0, 2**63).map(np.random.default_rng)
reals = st.floats(-1e6, 1e6)
poses = st.builds(Pose, reals, reals, st.floats(-math.pi, math.pi, exclude_max=True))
stamps = st.lists(st.integers(1, 2**31 * 10**9 - 1), min_size=8, max_size=9, unique=True).map(sorted)


def plain(value: Any) -> Any:
    """A value as nested lists of numbers and texts, to compare to the bit."""
    if isinstance(value, np.ndarray):
        return [str(value.dtype), value.shape, plain(value.ravel().tolist())]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.compare}
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if type(value).__name__ == "Stopwatch":
        return plain([value.rows, value.totals])
    return repr(value) if isinstance(value, float) else value


@few
@given(rngs)
def test_every_column_of_a_record_comes_back_to_the_bit(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        back, missing = load_record(folder)
    assert missing == () and back.name == "run" and back.config == trace.config
    for field in dataclasses.fields(Trace):
        if field.name not in NOT_KEPT:
            assert plain(getattr(back, field.name)) == plain(getattr(trace, field.name)), field.name
    assert back.grid is not None and trace.grid is not None and back.grid.origin == trace.grid.origin
    for name in ("hits", "passes", "seen", "obstacles"):
        assert np.array_equal(getattr(back.grid, name), getattr(trace.grid, name))
    assert np.array_equal(back.grid.free_space().blocked, trace.grid.free_space().blocked)


def test_the_motions_since_keyframes_that_the_end_of_a_run_refined_take_the_place_of_those_of_the_drive() -> None:
    trace = trace_of(np.random.default_rng(3))
    driven, trace.since_key = trace.since_key, trace_of(np.random.default_rng(5)).since_key
    with written(trace) as folder:
        lines = [json.loads(line) for line in (folder / "record.jsonl").read_text().splitlines()]
        scans = [line for line in lines if "scan" in line]
        for line, motion in zip(scans, driven, strict=True):
            line["since_key"] = motion.tolist()
        (folder / "record.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
        back, _ = load_record(folder)
    assert plain(back.since_key) == plain(trace.since_key) != plain(driven)


@few
@given(rngs)
def test_the_record_of_a_log_has_no_truth_and_keeps_the_last_place_of_a_killed_run(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    trace.truths, trace.key_truths, trace.walkers, trace.touches, trace.scene = [], [], [], None, None
    trace.plans_below_margin = trace.plans_by_astar = trace.guard_stops = trace.loop_closures = None
    with written(trace) as folder:
        back, _ = load_record(folder)
        assert not (folder / "truth.tum").exists()
        (folder / "record.npz").unlink()
        killed, missing = load_record(folder)
    assert (plain(killed.final), plain(killed.joint_cov)) == (
        plain(trace.key_estimates[-1]),
        plain(killed.final.pose_cov),
    )
    assert np.array_equal(killed.trajectory, [estimate.pose.array() for estimate in trace.key_estimates])
    names = ("truths", "walkers", "touches", "scene", "plans_below_margin", "plans_by_astar", "guard_stops")
    assert [getattr(back, name) for name in names] == [getattr(trace, name) for name in names]
    assert [part.name for part in missing] == ["END", "GRID"] and killed.outcome == "interrupted"
    assert np.array_equal(killed.last_position, trace.odometry[-1][:2])
    assert killed.path_length_m == trace.path_length_m and killed.stopwatch.totals == trace.stopwatch.totals


def test_a_killed_run_ends_at_its_last_true_place() -> None:
    trace = trace_of(np.random.default_rng(4))
    with written(trace) as folder:
        lines = (folder / "record.jsonl").read_bytes().splitlines(keepends=True)
        (folder / "record.jsonl").write_bytes(b"".join(lines[:-1]) + lines[-1][:-1])  # the last scan is cut
        (folder / "record.npz").unlink()
        killed, _ = load_record(folder)
    assert len(killed.stamps_ns) == len(trace.stamps_ns) - 1
    assert np.array_equal(killed.last_position, trace.truths[-2][:2])


DAMAGES: dict[str, Callable[[list[dict[str, Any]]], int]] = {
    "another format": lambda lines: lines[0].update(format=1) or 0,
    "a keyframe before it is there": lambda lines: lines[-1].update(last_key=4) or -1,
    "a scan at the time of the last": lambda lines: lines[-1].update(scan=lines[-2]["scan"]) or -1,
    "a keyframe at the time of the last": lambda lines: lines[2].update(keyframe=lines[1]["keyframe"]) or 2,
    "a scan without truth": lambda lines: lines[-1].pop("truths") and -1,
    "a number that is not finite": lambda lines: lines[-1].update(estimates=[0.5, math.inf, 0.5]) or -1,
    "a line of no table": lambda lines: lines.append({"end": 3}) or -1,
    "a count below 0": lambda lines: lines[1].update(fused=-1) or 1,
    "a count that is a fraction": lambda lines: lines[1].update(dof=1.5) or 1,
    "a truth in one line alone": lambda lines: [line.pop("truths") for line in lines[-7:-1]] and -1,
    "a stage too few": lambda lines: lines[1]["ms"].pop() and 1,
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_line_is_named(name: str) -> None:
    with written(trace_of(np.random.default_rng(2))) as folder:
        file = folder / "record.jsonl"
        lines = [json.loads(line) for line in file.read_text().splitlines()]
        number = DAMAGES[name](lines) % len(lines) + 1
        file.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
        with pytest.raises(InputError, match=rf"record.jsonl: line {number}: found .*, allowed: a line of a run"):
            load_record(folder)


COLUMNS = [column for field in END for column in field.columns]


@pytest.mark.parametrize("column", COLUMNS, ids=[column.name for column in COLUMNS])
def test_an_array_of_another_shape_or_type_is_named(column: Column) -> None:
    with written(trace_of(np.random.default_rng(6))) as folder:
        file = folder / "record.npz"
        with np.load(file) as content:
            arrays = dict(content)
        right = arrays[column.name]
        for wrong in (right[None], right.astype("V")):
            np.savez(file, **arrays | {column.name: wrong})
            with pytest.raises(InputError, match=rf"record.npz: found {column.name} of shape "):
                load_record(folder)


# Files for other programs


def tum(file: Path) -> list[tuple[Fraction, Array]]:
    """Stamps in seconds, and (7,) positions and quaternions x y z w."""
    rows = [line.split() for line in file.read_text().splitlines()]
    return [(Fraction(row[0]), np.array(row[1:], dtype=np.float64)) for row in rows]


@few
@given(rngs)
def test_trajectories_have_stamps_to_the_nanosecond_and_poses_to_the_last_digits(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        files = {name: tum(folder / f"{name}.tum") for name in ("estimate", "truth", "smoothed")}
    expected = {
        "estimate": (trace.stamps_ns, trace.estimates),
        "truth": (trace.stamps_ns, trace.truths),
        "smoothed": (trace.key_stamps_ns, trace.trajectory),
    }
    for name, (stamps_ns, rows) in expected.items():
        for (stamp_s, found), stamp_ns, (x, y, theta) in zip(files[name], stamps_ns, rows, strict=True):
            assert stamp_s == Fraction(stamp_ns, 10**9)
            assert found[:5].tolist() == [x, y, 0.0, 0.0, 0.0]
            assert np.allclose(found[5:], [math.sin(theta / 2), math.cos(theta / 2)], atol=1e-15)


@few
@given(rngs)
def test_tables_of_landmarks_have_each_number_in_its_column(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        with (folder / "landmarks.csv").open() as file:
            rows = list(csv.DictReader(file))
        with np.load(folder / "record.npz") as joint:
            arrays = dict(joint)
        places = list(csv.reader((folder / "places_left.csv").open()))
    for k, row in enumerate(rows):
        i, cov = int(row["id"]), trace.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
        record, mean = trace.records[i], trace.final.landmarks[k].tolist()
        own, other = (("alpha", "d"), ("x", "y"))[:: 1 if record.kind == Kind.WALL else -1]
        assert (i, row["kind"]) == (trace.final.ids[k], record.kind.name.lower())
        assert [float(row[name]) for name in own] == mean and [row[name] for name in other] == ["", ""]
        columns = COV_COLUMNS[record.kind == Kind.WALL]
        assert [float(row[name]) for name in columns] == [cov[0, 0], cov[0, 1], cov[1, 1]]
        assert [row[name] for name in COV_COLUMNS[record.kind != Kind.WALL]] == [""] * 3
        assert int(row["observations"]) == record.observations
        extent = [row[name] for name in ("from_x", "from_y", "to_x", "to_y")]
        assert extent == ([str(v) for v in record.extent.ravel().tolist()] if record.kind == Kind.WALL else [""] * 4)
    assert arrays["ids"].tolist() == trace.final.ids.tolist()
    assert arrays["walls"].tolist() == [trace.records[i].kind == Kind.WALL for i in trace.final.ids.tolist()]
    assert arrays["mean"].tolist() == [*trace.final.pose.array(), *trace.final.landmarks.ravel()]
    assert np.array_equal(arrays["covariance"], trace.joint_cov)
    gaps = ["" if p.gap_m is None else str(p.gap_m) for p in trace.left]
    assert places[1:] == [
        [str(p.x), str(p.y), str(p.area_m2), p.reason, g] for p, g in zip(trace.left, gaps, strict=True)
    ]
    assert places[0] == ["x", "y", "area_m2", "reason", "gap_m"]


@few
@given(rngs)
def test_the_map_read_by_the_rule_of_map_server_is_the_grid(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        meta = yaml.safe_load((folder / "map.yaml").read_text())
        image = np.asarray(Image.open(folder / meta["image"]))
    x0, y0, yaw = meta["origin"]
    assert (yaw, meta["negate"], meta["mode"]) == (0.0, 0, "trinary")
    assert (meta["occupied_thresh"], meta["free_thresh"]) == (0.65, 0.196)  # 205, unknown, is between the two
    found = {}
    for (row, column), value in np.ndenumerate(image):  # the first row is the top of the map
        occupied = (255 - int(value)) / 255.0
        state = 100 if occupied > meta["occupied_thresh"] else 0 if occupied < meta["free_thresh"] else -1
        x, y = x0 + (column + 0.5) * meta["resolution"], y0 + (image.shape[0] - row - 0.5) * meta["resolution"]
        found[round(x / 0.07, 3), round(y / 0.07, 3)] = state
    assert trace.grid is not None
    left, bottom = trace.grid.origin
    expected = {
        (round(left / 0.07 + column + 0.5, 3), round(bottom / 0.07 + row + 0.5, 3)): int(state)
        for (row, column), state in np.ndenumerate(trace.grid.occupancy())
    }
    assert {cell: state for cell, state in found.items() if state >= 0} == {
        cell: state for cell, state in expected.items() if state >= 0
    }


def turned(cov: Array, angle: float) -> Array:
    """A covariance in axes turned by an angle."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn @ cov @ turn.T


def edges_of(file: Path) -> tuple[dict[tuple[int, int], tuple[Array, Array]], Any]:
    """Motion, and covariance in the axes of the second pose, of each edge that GTSAM reads; and the poses."""
    graph, values = gtsam.readG2o(str(file))
    found = {}
    for k in range(graph.size()):
        factor = graph.at(k)
        if isinstance(factor, gtsam.BetweenFactorPose2):
            motion = factor.measured()
            key = (factor.keys()[0], factor.keys()[1])
            found[key] = np.array([motion.x(), motion.y(), motion.theta()]), factor.noiseModel().covariance()
    return found, values


@few
@given(rngs)
def test_the_factor_graph_has_each_measurement_with_its_covariance_in_its_axes(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        found, values = edges_of(folder / "graph.g2o")
        lines = [line.split() for line in (folder / "graph.g2o").read_text().splitlines()]
        with np.load(folder / "graph.npz") as file:
            arrays = dict(file)
    assert trace.links is not None
    motions = {(k, k + 1): (m.motion.array(), m.cov) for k, m in enumerate(trace.key_odometry[1:])}
    motions |= {tuple(e): (m, c) for e, m, c in zip(trace.links.ends.tolist(), *trace.links[1:], strict=True)}
    assert found.keys() == motions.keys()
    for ends, (motion, cov) in motions.items():
        assert np.allclose(found[ends][0], motion, atol=1e-9)
        assert np.allclose(found[ends][1], turned(cov, motion[2]), rtol=1e-6, atol=1e-8)
    for k, pose in enumerate(trace.trajectory):
        at = values.atPose2(k)
        assert np.allclose([at.x(), at.y(), at.theta()], pose, atol=1e-9)
    kept = [7, 4, 11]
    seen = [(k, i, o) for k, a in enumerate(trace.associations) for i, o in a.observations.items() if i in kept]
    points = [(k, i, o) for k, i, o in seen if i != 7]
    assert arrays["landmark_ids"].tolist() == [4, 11] and arrays["wall_ids"].tolist() == [7]
    assert np.array_equal(arrays["landmarks"], trace.final.landmarks[[1, 3]])
    assert np.array_equal(arrays["walls"], trace.final.landmarks[:1])
    assert arrays["observation_of"].tolist() == [[k, {4: 0, 11: 1}[i]] for k, i, _ in points]
    assert np.array_equal(arrays["observations"], [o.z for *_, o in points])
    assert np.array_equal(arrays["observation_covs"], [o.cov for *_, o in points])
    assert arrays["wall_observation_of"].tolist() == [[k, 0] for k, i, _ in seen if i == 7]
    assert np.array_equal(arrays["wall_observations"], [o.z for _, i, o in seen if i == 7])
    assert np.array_equal(arrays["wall_observation_covs"], [o.cov for _, i, o in seen if i == 7])
    assert np.array_equal(arrays["poses"], trace.trajectory)
    of_landmarks = [line for line in lines if line[0] == "VERTEX_XY"]
    assert [[float(v) for v in line[1:]] for line in of_landmarks] == [
        [4 + j, *trace.final.landmarks[1 + 2 * j]] for j in range(2)
    ]
    polar = [o.bearing_range() for *_, o in points]
    assert [[float(v) for v in line[1:]] for line in lines if line[0] == "BR"] == [
        [k, 4 + {4: 0, 11: 1}[i], bearing, distance, *np.sqrt(np.diag(cov))]
        for (k, i, _), (bearing, distance, cov) in zip(points, polar, strict=True)
    ]


# The bag


def scans_of(rng: np.random.Generator, count: int) -> Iterator[Scan]:
    """Scans of which each differs from the one before in its ranges, and in one thing that its laser says of itself."""
    angles = np.float32(-1.7), np.float32(0.3)
    scan = Scan(np.zeros(6, np.float32), *angles, 7.3, Pose(*CONFIG.laser.mount), np.float32(0.004))
    changes = itertools.cycle([
        {}, {"angle_min": np.float32(-0.9)}, {"time_increment": np.float32(-0.006)}, {"max_range": 6.5},
        {"angle_increment": np.float32(0.2)}, {"time_increment": np.float32(0.003)},
    ])  # fmt: skip
    for change in itertools.islice(changes, count):
        ranges = rng.uniform(0.5, 5.0, len(scan.ranges) + (not change)).astype(np.float32)
        ranges[rng.integers(len(ranges))] = np.inf
        scan = dataclasses.replace(scan, ranges=ranges, **change)
        yield scan


def ticks_of(rng: np.random.Generator, at_ns: list[int], stamped: bool) -> list[Tick]:
    """The ticks of a log with scans, known landmarks and loop closures, with stamps of its own or without."""
    found: list[Tick] = []
    for stamp_ns, scan in zip(at_ns, scans_of(rng, len(at_ns)), strict=True):
        seen = {int(i): observation_of(rng, Kind(i % 3)) for i in rng.choice(99, 3, replace=False)}
        seen = {i: dataclasses.replace(o, extent=(0.0, 0.0)) for i, o in seen.items()}  # no cloud has it
        own_s = float(rng.integers(1, 2**31)) + 0.25 if stamped else None
        ends = rng.permutation(len(found))[:2].tolist()
        loops = tuple(Closure(k, pose_of(rng), cov_of(rng)) for k in ends)
        found.append(
            Tick(stamp_ns, pose_of(rng), scan, seen, cov_of(rng), pose_of(rng), log_stamp_s=own_s, closures=loops)
        )
    return found


def bag_of(place: str, ticks: list[Tick], trace: Trace, grow: Callable[[int], object] = lambda k: None) -> Path:
    with BagWriter(Path(place)) as bag:
        for k, tick in enumerate(ticks):
            grow(k)
            bag(tick, trace)
    return Path(place)


def read_messages(folder: Path) -> dict[str, list[tuple[int, Any]]]:
    """Record times and messages by topic."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([folder / "bag"]) as reader:
        for connection, record_ns, raw in reader.messages():
            found.setdefault(connection.topic, []).append((record_ns, reader.deserialize(raw, connection.msgtype)))
    return found


def pose_in(message: Any) -> list[float]:
    q = message.orientation
    assert (message.position.z, q.x, q.y) == (0.0, 0.0, 0.0)
    return [message.position.x, message.position.y, 2.0 * math.atan2(q.z, q.w)]


def header_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


@few
@given(rngs, stamps)
def test_every_tick_of_a_log_comes_back_from_the_bag_to_the_bit(rng: np.random.Generator, at_ns: list[int]) -> None:
    ticks = ticks_of(rng, at_ns, stamped=True)
    with tempfile.TemporaryDirectory() as place:
        back = read_run(bag_of(place, ticks, Trace(CONFIG, None, RADIUS_M)), CONFIG.laser).ticks
    for one, two in zip(ticks, back, strict=True):
        for field in dataclasses.fields(Tick):
            assert plain(getattr(two, field.name)) == plain(getattr(one, field.name)), field.name


@few
@given(rngs, stamps)
def test_messages_of_a_run_have_their_frames_stamps_poses_and_covariances(
    rng: np.random.Generator, at_ns: list[int]
) -> None:
    trace, ticks = Trace(CONFIG, None, RADIUS_M), ticks_of(rng, at_ns, stamped=False)

    def grow(k: int) -> None:
        trace.key_estimates.append(Estimate.of_pose(pose_of(rng), cov_of(rng)))
        trace.plans.extend(rng.normal(size=(k % 3, 3, 2)))
        trace.tours.append(rng.normal(size=(4, 2)))

    with tempfile.TemporaryDirectory() as place:
        folder = bag_of(place, ticks, trace, grow)
        found = read_messages(folder)
        meta = yaml.safe_load((folder / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    ((first_ns, static),) = found.pop("/tf_static")
    (mount,) = static.transforms
    assert first_ns == header_ns(mount) == at_ns[0]
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "laser")
    at, q = mount.transform.translation, mount.transform.rotation
    assert [at.x, at.y, 2.0 * math.atan2(q.z, q.w)] == pytest.approx(CONFIG.laser.mount)
    loops = [(tick.stamp_ns, loop) for tick in ticks for loop in tick.closures or ()]
    for (stamp, loop), (ns, message) in zip(loops, found.pop("/closures"), strict=True):
        assert (ns, message.header.frame_id) == (stamp, str(loop.before))
        assert pose_in(message.pose.pose) == loop.motion.array().tolist()
    frames = {"/odom": "odom", "/scan": "laser", "/observations": "base_link"}
    for topic, messages in found.items():
        assert {message.header.frame_id for _, message in messages} == {frames.get(topic, "map")}
        if topic != "/scan":
            assert all(header_ns(message) == record_ns for record_ns, message in messages)
    assert [ns for ns, _ in found["/odom"]] == [ns for ns, _ in found["/estimate"]] == at_ns
    for tick, (ns, message), (_, odom) in zip(ticks, found["/scan"], found["/odom"], strict=True):
        assert tick.scan is not None and odom.child_frame_id == "base_link"
        begin_s = sweep_times(len(tick.scan.ranges), tick.scan.time_increment).min()
        assert ns == tick.stamp_ns and header_ns(message) == max(0, tick.stamp_ns + round(1e9 * begin_s))
        assert message.angle_max == pytest.approx(tick.scan.bearings[-1], abs=1e-5)
        assert (message.range_min, message.range_max) == (0.0, np.float32(tick.scan.max_range))
    for estimate, (_, message) in zip(trace.key_estimates, found["/estimate"], strict=True):
        assert pose_in(message.pose.pose) == estimate.pose.array().tolist()
        cov = message.pose.covariance.reshape(6, 6)
        assert np.array_equal(cov[np.ix_((0, 1, 5), (0, 1, 5))], estimate.pose_cov) and np.count_nonzero(cov) == 9
    for topic, paths in (("/plan", trace.plans), ("/tour", trace.tours)):
        points = [[pose_in(p.pose) for p in message.poses] for _, message in found.get(topic, [])]
        assert points == [[[x, y, 0.0] for x, y in path.tolist()] for path in paths]
    counts = {one["topic_metadata"]["name"]: one["message_count"] for one in meta["topics_with_message_count"]}
    assert counts == {"/tf_static": 1, "/plan": 0, "/closures": len(loops)} | {
        topic: len(messages) for topic, messages in found.items()
    }
    assert meta["message_count"] == sum(counts.values())
    assert meta["starting_time"]["nanoseconds_since_epoch"] == at_ns[0]
    assert meta["duration"]["nanoseconds"] == at_ns[-1] - at_ns[0]
    qos = {
        one["topic_metadata"]["name"]: one["topic_metadata"]["offered_qos_profiles"]
        for one in meta["topics_with_message_count"]
    }
    assert [one["durability"] for one in yaml.safe_load(qos.pop("/tf_static"))] == [1] and set(qos.values()) == {""}


@given(poses, st.integers(0, 2**31 * 10**9 - 1))
def test_a_heading_in_a_message_is_read_back_to_the_bit(pose: Pose, stamp_ns: int) -> None:
    message = Messages().pose_stamped(stamp_ns, pose)
    if abs(pose.theta) > 1e-300:
        assert pose_in(message.pose) == pose.array().tolist()
    assert header_ns(message) == stamp_ns


def test_commands_and_the_map_of_a_live_robot_have_each_number_in_its_place() -> None:
    make = Messages()
    twist = make.twist_stamped(7_000_000_009, "base", 0.3, -0.7)
    assert (twist.twist.linear.x, twist.twist.angular.z, header_ns(twist)) == (0.3, -0.7, 7_000_000_009)
    assert twist.header.frame_id == "base"
    cells = np.array([[-1, 0, 100], [0, 100, -1]], dtype=np.int8)
    grid = make.occupancy(5, cells, (-1.5, 2.25), 0.07)
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (3, 2, 0.07)
    assert pose_in(grid.info.origin) == [-1.5, 2.25, 0.0]
    assert grid.data.tolist() == [-1, 0, 100, 0, 100, -1]  # row by row, from the lower left
