"""What a run's record and its exports hold is what was put there, for general poses, shapes and covariances."""

import csv
import dataclasses
import itertools
import math
import tempfile
from collections.abc import Iterator, Sequence
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

from sixthsense.config import save_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan, sweep_times
from sixthsense.core.source import Closure, Tick
from sixthsense.figures.run import Run
from sixthsense.logs.runfolder import FILE, FORMAT, read_run
from sixthsense.record import stream
from sixthsense.record.exports import write_bag, write_g2o, write_graph
from sixthsense.record.store import END, GRID, load_record
from sixthsense.record.stream import RecordWriter
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate

NOT_KEPT = {"config", "live", "grid", "name", "prior_map", "key_scans"}
"""fields of a trace that the record does not have, or that are compared elsewhere"""

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
def test_every_field_of_a_trace_comes_back_to_the_bit(rng: np.random.Generator) -> None:
    trace = trace_of(rng)
    with written(trace) as folder:
        back, missing, metrics = load_record(folder)
    assert (missing, metrics, back.name, back.config) == ((), {"some": 1.5}, "run", trace.config)
    for field in dataclasses.fields(Trace):
        if field.name not in NOT_KEPT:
            assert plain(getattr(back, field.name)) == plain(getattr(trace, field.name)), field.name
    assert back.grid is not None and trace.grid is not None and back.grid.origin == trace.grid.origin
    for name in ("hits", "passes", "seen", "obstacles"):
        assert np.array_equal(getattr(back.grid, name), getattr(trace.grid, name))
    assert np.array_equal(back.grid.free_space().blocked, trace.grid.free_space().blocked)


def test_a_trace_without_what_is_optional_comes_back_without_it() -> None:
    trace = trace_of(np.random.default_rng(8))
    trace.truths, trace.key_truths, trace.walkers, trace.touches, trace.scene = [], [], [], None, None
    trace.links = trace.relations = trace.wheels = trace.sensor = trace.grid = trace.loop_closures = None
    trace.verdict = trace.plans_below_margin = trace.plans_by_astar = trace.guard_stops = None
    trace.records, trace.joint_cov, trace.left = {}, trace.joint_cov[:3, :3], []
    trace.final = Estimate.of_pose(trace.final.pose, trace.joint_cov)
    with written(trace) as folder:
        back, missing, _ = load_record(folder)
        assert not (folder / "truth.tum").exists() and not (folder / "map.pgm").exists()
    assert missing == (GRID,)
    for field in dataclasses.fields(Trace):
        if field.name not in NOT_KEPT:
            assert plain(getattr(back, field.name)) == plain(getattr(trace, field.name)), field.name


def streamed(place: Path, trace: Trace, ticks: Sequence[Tick] = ()) -> Path:
    """A folder with the record of a run that was stopped after these ticks."""
    save_config(CONFIG, place / "config.toml")
    record = RecordWriter(place / FILE)
    for tick in ticks or [Tick(1, Pose())]:
        record(tick, trace)
    record.close()
    return place


def test_a_run_that_was_stopped_ends_with_its_last_keyframe_and_place(tmp_path: Path) -> None:
    trace = trace_of(np.random.default_rng(4))
    back, missing, metrics = load_record(streamed(tmp_path, trace))
    assert (back.outcome, metrics, missing) == ("interrupted", None, (END, GRID))
    assert plain(back.final) == plain(trace.key_estimates[-1]) and back.scene is not None
    assert np.array_equal(back.trajectory, [estimate.pose.array() for estimate in trace.key_estimates])
    assert np.array_equal(back.last_position, trace.truths[-1][:2])
    assert back.path_length_m == trace.path_length_m and back.stopwatch.totals == trace.stopwatch.totals
    assert plain(back.since_key) == plain(trace.since_key) and plain(back.plans) == plain(trace.plans)


@pytest.mark.parametrize("kind", ["an older run", "text", "nothing", "no scan", "another format"])
def test_what_is_no_record_of_this_version_is_refused_in_a_line(tmp_path: Path, kind: str, monkeypatch: Any) -> None:
    monkeypatch.setattr(stream, "FORMAT", 2 if kind == "another format" else FORMAT)
    file = streamed(tmp_path, Trace(CONFIG, None, RADIUS_M)) / FILE
    if kind == "an older run":
        file.rename(tmp_path / "record.jsonl")
    elif kind in ("text", "nothing"):
        file.write_text("text" * (kind == "text"))
    with pytest.raises(InputError, match=rf"{FILE}: (no such file|is not an MCAP file|found no (scan|record))") as told:
        load_record(tmp_path)
    assert "\n" not in str(told.value) and ", allowed: the " in str(told.value)


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
        Run("run", trace).to_csv(folder)
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
        shades = np.asarray(Image.open(folder / meta["image"]))[::-1]  # the first row is the top of the map
    assert trace.grid is not None and (meta["negate"], meta["mode"], meta["origin"][2]) == (0, "trinary", 0.0)
    occupied = (255 - shades.astype(int)) / 255.0
    found = np.where(occupied > meta["occupied_thresh"], 100, np.where(occupied < meta["free_thresh"], 0, -1))
    ends = [np.subtract(meta["origin"][k], trace.grid.origin[k]) / meta["resolution"] for k in (1, 0)]
    row, column = (round(end) for end in ends)
    expected = trace.grid.occupancy()
    rows, columns = found.shape
    assert np.array_equal(found, expected[row : row + rows, column : column + columns])
    assert np.count_nonzero(found >= 0) == np.count_nonzero(expected >= 0) > 0


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
        write_g2o(folder / "graph.g2o", trace)
        write_graph(folder / "graph.npz", trace)
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
        assert np.allclose(found[ends][1], cov, rtol=1e-6, atol=1e-8)
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
    assert arrays["wall_observation_of"].tolist() == [[k, 0] for k, i, _ in seen if i == 7]
    assert np.array_equal(arrays["wall_observations"], [o.z for _, i, o in seen if i == 7])
    assert np.array_equal(arrays["wall_observation_covs"], [o.cov for _, i, o in seen if i == 7])
    assert np.array_equal(arrays["poses"], trace.trajectory)
    of_landmarks = [line for line in lines if line[0] == "VERTEX_XY"]
    assert [[float(v) for v in line[1:]] for line in of_landmarks] == [
        [4 + j, *trace.final.landmarks[1 + 2 * j]] for j in range(2)
    ]
    polar = [o.bearing_range() for *_, o in points]
    assert np.array_equal(arrays["bearing_range_covs"], [cov for *_, cov in polar])
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
def test_every_tick_of_a_log_comes_back_to_the_bit(rng: np.random.Generator, at_ns: list[int]) -> None:
    ticks = ticks_of(rng, at_ns, stamped=True)
    ticks[1] = dataclasses.replace(ticks[1], scan=None, observations={}, truth=None, is_unmeasured=True)
    ticks[2] = dataclasses.replace(ticks[2], observations=None, increment_cov=None, log_stamp_s=None)
    with tempfile.TemporaryDirectory() as place:
        back = read_run(streamed(Path(place), Trace(CONFIG, None, RADIUS_M), ticks), CONFIG.laser).ticks
    assert ticks[2].scan is not None
    began_ns = ticks[2].stamp_ns + round(1e9 * ticks[2].scan.times_s.min())
    ticks[2] = dataclasses.replace(ticks[2], log_stamp_s=max(began_ns, 0) / 1e9)
    for one, two in zip(ticks, back, strict=True):
        for field in dataclasses.fields(Tick):
            assert plain(getattr(two, field.name)) == plain(getattr(one, field.name)), field.name


def test_messages_of_a_bag_have_their_frames_stamps_poses_and_covariances(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    trace = trace_of(rng)
    ticks = ticks_of(rng, trace.stamps_ns, stamped=False)
    trace.tours = [rng.normal(size=(4, 2))]
    write_bag(tmp_path / "bag", streamed(tmp_path, trace, ticks), trace)
    found = read_messages(tmp_path)
    ((first_ns, static),) = found.pop("/tf_static")
    (mount,) = static.transforms
    assert first_ns == header_ns(mount) == ticks[0].stamp_ns
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "laser")
    at, q = mount.transform.translation, mount.transform.rotation
    assert [at.x, at.y, 2.0 * math.atan2(q.z, q.w)] == pytest.approx(CONFIG.laser.mount)
    frames = {"/odom": "odom", "/scan": "laser"}
    for topic, messages in found.items():
        assert {message.header.frame_id for _, message in messages} == {frames.get(topic, "map")}
        if topic != "/scan":
            assert all(header_ns(message) == record_ns for record_ns, message in messages)
    for tick, (ns, scan), (_, odom), (_, truth) in zip(
        ticks, found["/scan"], found["/odom"], found["/truth"], strict=True
    ):
        assert tick.scan is not None and tick.truth is not None and odom.child_frame_id == "base_link"
        assert pose_in(odom.pose.pose) == pytest.approx(tick.odometry.array())
        assert pose_in(truth.pose) == pytest.approx(tick.truth.array())
        begin_s = sweep_times(len(tick.scan.ranges), tick.scan.time_increment).min()
        assert (ns, header_ns(scan)) == (tick.stamp_ns, pytest.approx(tick.stamp_ns + 1e9 * begin_s, abs=200))
        assert scan.angle_max == pytest.approx(tick.scan.bearings[-1], abs=1e-5)
        assert (scan.range_min, scan.range_max) == (0.0, np.float32(tick.scan.max_range))
        assert np.array_equal(scan.ranges, tick.scan.ranges)
    assert [ns for ns, _ in found["/estimate"]] == trace.key_stamps_ns
    for estimate, (_, message) in zip(trace.key_estimates, found["/estimate"], strict=True):
        assert pose_in(message.pose.pose) == pytest.approx(estimate.pose.array())
        cov = message.pose.covariance.reshape(6, 6)
        assert np.array_equal(cov[np.ix_((0, 1, 5), (0, 1, 5))], estimate.pose_cov) and np.count_nonzero(cov) == 9
    for topic, paths in (("/plan", trace.plans), ("/tour", trace.tours)):
        points = [[pose_in(p.pose) for p in message.poses] for _, message in found[topic]]
        assert points == [[[x, y, 0.0] for x, y in path.tolist()] for path in paths]
