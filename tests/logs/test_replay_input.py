"""What a replay takes: its base, its options, its laser, its relations and their stamps."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from bags import Bag

from sixthsense.config import merge, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.logs.log import Log, Relations, ascending, matched, passed_s
from sixthsense.logs.replay_input import (
    LogSelection,
    base_of,
    check_options,
    check_out,
    open_recorded,
    recorded_scene,
)
from sixthsense.logs.text_lines import unit_of

S = 1_000_000_000


@pytest.fixture
def logs(tmp_path: Path) -> dict[str, Path]:
    """One of each kind; what is in them says of what kind they are."""
    carmen = "".join(f"FLASER 3 2.5 3.5 4.5 {k}.3 0.4 0.7 {k}.1 0.2 0.7 {k + 7}.25 host 0.5\n" for k in range(4))
    (tmp_path / "a.log").write_text(carmen)
    (tmp_path / "a.g2o").write_text("EDGE_SE2 3 4 0.5 0.6 0.7 9 0 0 8 0 7\n")
    for folder, name, text in (
        ("run", "config.toml", 'preset = "worn"\nseed = 7\n'), ("mrclam", "Robot3_Odometry.dat", "1 2 3\n"),
    ):  # fmt: skip
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(text)
    with Bag(tmp_path / "bag") as bag:
        for k in range(9):
            bag.odometry(S + k * S, Pose(0.3 * k, 0.2, 0.4))
            bag.scan(S + k * S, [2.5, 3.5, 4.5])
    kinds = {"carmen": "a.log", "graph": "a.g2o", "bag": "bag", "run": "run", "mrclam": "mrclam"}
    return {kind: tmp_path / name for kind, name in kinds.items()}


def test_the_base_of_a_replay_is_that_of_the_kind_of_its_log(logs) -> None:
    found = {kind: base_of(log) for kind, log in logs.items() if kind != "run"}
    assert found == {"carmen": "log", "bag": "log", "graph": "victoria", "mrclam": "mrclam"}
    assert base_of(None) == "log" and base_of(logs["run"]).seed == 7


@pytest.mark.parametrize(("kind", "fields", "chosen", "refused"), [
    ("bag", {"robot": {"speed": 0.3}}, {}, "robot: found on replay"),
    (None, {"task": "tour"}, {}, "task: found on replay"),
    ("graph", {"world": {"walkers": 3}}, {}, "world: found on replay"),
    ("bag", {"laser": {"fov": 3.0}}, {}, "laser.fov: found on a log of kind bag, allowed: `topics`"),
    ("graph", {"laser": {"mount": (0.2, 0.3, 0.4)}}, {}, "laser.mount: found on a log of kind graph"),
    ("carmen", {}, {"topics": ("/scan",)}, "topics: found on a log of kind carmen"),
    ("bag", {}, {"robot": 3}, "robot: found on a log of kind bag"),
    ("mrclam", {"robot": {"radius": 0.3}}, {"robot": 3}, ""), ("bag", {}, {"odometry_frames": ("odom", "base")}, ""),
    ("carmen", {"robot": {"radius": 0.3}, "laser": {"mount": (0.2, 0.3, 0.4), "fov": 3.0}, "preset": "log"}, {}, ""),
])  # fmt: skip
def test_an_option_of_the_recorded_robot_or_without_a_use_for_the_log_is_refused(
    logs, kind, fields, chosen, refused
) -> None:
    with pytest.raises(InputError, match=f"^{refused}") if refused else nullcontext():
        check_options(logs.get(kind), fields, LogSelection(**chosen).given())


def test_a_replay_does_not_write_over_its_own_log(tmp_path: Path) -> None:
    log = tmp_path / "x.partial"
    check_out(log, tmp_path / "y")
    check_out(log, None)
    for path in (log, log / "record.mcap"):
        with pytest.raises(InputError, match=r"whose \.partial is the log itself"):
            check_out(path, tmp_path / "x")


def test_a_log_is_opened_with_its_laser_or_the_one_stated_and_without_odometry_if_so_told(logs) -> None:
    base = preset("log", laser={"max_range": 4.0})
    found = open_recorded(logs["carmen"], base)
    assert (found.name, found.config.laser.beams, found.config.laser.max_range) == ("a.log", 3, 4.0)
    mount = Pose(theta=0.7).inverse() @ Pose(0.2, 0.2, 0.7)  # in the axes of the robot
    assert found.config.laser.mount == pytest.approx(tuple(mount.array()), abs=1e-6)
    stated = open_recorded(logs["carmen"], preset("log", laser={"mount": (0.0, 0.0, 0.0), "max_range": 10.0}))
    assert (stated.config.laser.mount, stated.config.laser.max_range) == ((0.0, 0.0, 0.0), 10.0)
    assert open_recorded(logs["bag"], base).config.no_odometry is False
    without = open_recorded(logs["bag"], merge(base, {"no_odometry": True}), chosen=LogSelection(topics=("/scan",)))
    assert not without.log.has_odometry and without.files["topics"] == "/scan"
    assert any(note.startswith("no odometry is used") for note in without.notes)
    with Bag(logs["run"].parent / "scans") as bag:
        bag.scan(S, [2.5, 3.5, 4.5])
    assert open_recorded(bag.path, base).config.no_odometry


def test_the_scene_of_a_log_is_that_of_a_simulated_run_whose_file_is_still_there() -> None:
    scan = Scan(np.array([2.5, 3.5], np.float32), np.float32(-0.7), np.float32(0.3), 9.0)
    true, plain = (Log([Tick(7, Pose(), scan, truth=truth)]) for truth in (Pose(0.3, 0.2, 0.7), None))
    config = preset(scene="office")
    assert recorded_scene(true, config).name == "office" and recorded_scene(plain, config) is None
    assert recorded_scene(Log([Tick(7, Pose(), truth=Pose())]), config) is None
    assert recorded_scene(true, merge(config, {"scene": "gone.toml"})) is None


def test_relations_that_name_stamps_of_no_scan_are_left_out_and_counted(logs, tmp_path: Path) -> None:
    rows = [(7.25, 9.25, 0.3), (7.25, 11.5, 0.4), (8.25, 10.3, 0.5), (1.5, 2.5, 0.6), (2.5, 8.25, 0.7)]
    file = tmp_path / "a.relations"
    file.write_text("".join(f"{a} {b} {x} 0.2 0 0 0 0.9\n" for a, b, x in rows))
    base = preset("log", laser={"max_range": 4.0})
    found = open_recorded(logs["carmen"], base, file)
    assert found.relations.stamps.tolist() == [[7.25, 9.25], [8.25, 10.25]]
    assert found.relations.poses.tolist() == [[0.3, 0.2, 0.9], [0.5, 0.2, 0.9]]
    assert any(note.startswith("2 of 5 relations are of scans, 0.05 s away") and "; 3 " in note for note in found.notes)
    assert found.files == {"log": str(logs["carmen"]), "relations": str(file)}
    none = Relations(np.array([[1.5, 8.25]]), np.array([[0.3, 0.2, 0.9]]))
    with pytest.raises(
        InputError, match=r"relations: found no relation between scans of the log \(the first is of 1.5"
    ):
        open_recorded(logs["carmen"], base, none)


def test_a_stamp_matches_the_nearest_one_within_half_a_period():
    rng = np.random.default_rng(2)
    for _ in range(20):
        stamps = 1.7e9 + np.cumsum(rng.uniform(0.1, 0.4, 30))[rng.permutation(30)]
        wanted = 1.7e9 + rng.uniform(-1.0, 9.0, (40, 2))
        found, half = matched(stamps, wanted), 0.5 * np.median(np.diff(np.sort(stamps)))
        for row, at in zip(found.ravel(), wanted.ravel(), strict=True):
            off = np.abs(stamps - at)
            assert row == (np.argmin(off) if off.min() <= half else -1)
    assert matched([3.0, 1.0, 3.0], [3.2, 1.0, 4.5]).tolist() == [0, 1, -1]
    assert matched([5.0], [5.0, 5.1]).tolist() == [0, -1] and matched([], [1.0]).tolist() == [-1]


def test_stamps_ascend_are_spread_where_they_are_shared_and_are_of_the_unit_that_makes_them_recent():
    assert ascending([7, 9, 3, 4, 30]).tolist() == [7, 9, 10, 11, 30]
    for stamps_s, expected in (
        ([1.0, 1.3, 1.7], [0.3, 0.4]), ([1.0, 1.0, 1.6, 2.0], [0.3, 0.3, 0.4]),
        ([1.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0]), ([7.0, 7.0, 7.0], [np.inf, np.inf]),
    ):  # fmt: skip
        assert passed_s(np.round(1e9 * np.array(stamps_s)).astype(np.int64)) == pytest.approx(expected)
    for stamp, name in ((1.7e9, "seconds"), (3.0, "seconds"), (1.7e12, "milliseconds"), (1.7e18, "nanoseconds")):
        assert unit_of(np.array([stamp, 1.01 * stamp]))[1] == name
