import csv
import dataclasses
import itertools
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import Config, load_config, preset
from sixthsense.core.geometry import Array, point_segment_distance, wrap_angle
from sixthsense.evaluation.measure import measure
from sixthsense.figures.plot import save_map
from sixthsense.loop import run
from sixthsense.record.folder import FolderError, RunFolder, write_map, write_tum
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole
from sixthsense.sources.ros_map import read_map

CORNERS = {"landmarks": "corners"}
CONFIG = preset(scene="rectangle", task="tour", max_time=15.0, seed=5, features=CORNERS)
FILES = [
    "config.toml", "estimate.tum", "figures", "figures/map.png", "graph.g2o", "graph.npz", "grid.npz",
    "landmarks.csv", "landmarks.npz", "map.pgm", "map.yaml", "metrics.json", "record.jsonl", "record.npz",
    "smoothed.tum", "truth.tum",
]  # fmt: skip
KEYS = {
    "outcome", "collisions", "coverage", "ate_rmse_m", "ate_max_m", "dead_reckoning_ate_rmse_m", "heading_rmse_rad",
    "pose_nees_world_mean", "pose_nees_in_band", "pose_nees_effective_samples",
    "prediction_nees_world_mean", "pose_nees_invariant_mean",
    "landmark_nees_mean", "nis_mean_per_dof", "discarded_share", "landmarks", "landmarks_culled",
    "walls_merged", "scans", "keyframes", "largest_gap_s", "area_seen_m2",
    "landmark_rmse_m", "path_length_m", "plans", "plans_below_margin", "guard_stops", "sim_time_s", "wall_time_s",
    "realtime_factor", "scan_ms_p50", *(f"rpe_{what}_{m}m" for what in ("trans_m", "rot_deg") for m in (1, 2, 5)),
    "scan_ms_p99", "scan_ms_max",
    *(f"stage_ms_mean.{s}" for s in ("sense", "extract", "associate", "predict", "update", "grid", "plan")),
}  # fmt: skip


@pytest.fixture(scope="module")
def trace() -> Trace:
    return run(CONFIG)


@pytest.fixture(scope="module")
def out(trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A finished run's folder."""
    folder = RunFolder(tmp_path_factory.mktemp("runs") / "some", CONFIG)
    folder.write(trace, measure(trace))
    save_map(trace, folder.partial / "figures" / "map.png", "a title")
    folder.finish()
    yield folder.out


def tum(file: Path) -> Array:
    return np.loadtxt(file, dtype=np.float64).reshape(-1, 8)


def entries(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_a_finished_folder_holds_every_file_and_nothing_beside_it(out: Path) -> None:
    assert entries(out) == sorted(FILES)
    assert [p.name for p in out.parent.iterdir()] == ["some"]


def test_the_configuration_is_read_back_as_it_was(out: Path) -> None:
    assert load_config(out / "config.toml") == CONFIG


@pytest.mark.parametrize("name", ["estimate", "smoothed", "truth"])
def test_stamps_ascend_strictly_and_quaternions_are_turns_about_z(name: str, out: Path) -> None:
    rows = tum(out / f"{name}.tum")
    stamps = [line.split()[0] for line in (out / f"{name}.tum").read_text().splitlines()]
    nanoseconds = [int(stamp.replace(".", "")) for stamp in stamps]
    assert all(a < b for a, b in itertools.pairwise(nanoseconds))
    assert np.all(rows[:, 3:6] == 0.0)
    assert np.hypot(rows[:, 6], rows[:, 7]) == pytest.approx(1.0)


def test_trajectories_are_those_of_the_run_to_the_last_digit(out: Path, trace: Trace) -> None:
    truth, smoothed = tum(out / "truth.tum"), tum(out / "smoothed.tum")
    assert np.array_equal(truth[:, 1:3], np.array(trace.truths)[:, :2])
    headings = 2.0 * np.arctan2(truth[:, 6], truth[:, 7])
    assert wrap_angle(headings - np.array(trace.truths)[:, 2]) == pytest.approx(0.0, abs=1e-12)
    assert len(truth) == len(tum(out / "estimate.tum")) == len(trace.stamps_ns)
    assert len(smoothed) == len(trace.key_stamps_ns)
    assert set(smoothed[:, 0]) <= set(truth[:, 0])


def test_stamps_count_from_the_runs_beginning_so_that_doubles_tell_them_apart(tmp_path: Path) -> None:
    origin = 1_234_567_890_123_456_789
    stamps = [origin, origin + 1, origin + 3_000_000_000_002, origin + 3_000_000_000_003]
    write_tum(tmp_path / "x.tum", stamps, np.zeros((4, 3)), origin)
    first = [line.split()[0] for line in (tmp_path / "x.tum").read_text().splitlines()]
    assert first == ["0.000000000", "0.000000001", "3000.000000002", "3000.000000003"]
    assert len({float(stamp) for stamp in first}) == 4


def test_metrics_have_the_keys_of_a_simulated_run_and_are_strict_json(out: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    values = json.loads((out / "metrics.json").read_text(), parse_constant=refuse)
    assert set(values) == KEYS
    assert values["outcome"] == "tour ended"
    assert 0.0 <= values["coverage"] <= 1.0
    assert values["sim_time_s"] == pytest.approx(CONFIG.max_time, abs=0.2)


def test_the_joint_covariance_is_symmetric_and_positive_and_goes_with_its_mean(out: Path, trace: Trace) -> None:
    with np.load(out / "landmarks.npz") as joint:
        ids, kinds, mean, covariance = (joint[name] for name in ("ids", "kinds", "mean", "covariance"))
    assert len(ids) == len(kinds) > 0
    assert mean.shape == (3 + 2 * len(ids),)
    assert covariance.shape == (len(mean), len(mean))
    assert np.array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12
    assert mean[:3].tolist() == trace.final.pose.array().tolist()
    assert np.array_equal(covariance[:3, :3], trace.final.pose_cov)


def test_the_landmarks_table_tells_the_same_as_the_arrays(out: Path) -> None:
    with (out / "landmarks.csv").open() as file:
        rows = list(csv.DictReader(file))
    with np.load(out / "landmarks.npz") as joint:
        assert [int(row["id"]) for row in rows] == joint["ids"].tolist()
        for k, row in enumerate(rows):
            block = joint["covariance"][3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
            assert (float(row["x"]), float(row["y"])) == tuple(joint["mean"][3 + 2 * k : 5 + 2 * k])
            assert (float(row["cov_xx"]), float(row["cov_xy"])) == tuple(block[0])
            assert float(row["cov_yy"]) == block[1, 1]
            assert row["kind"] in ("corner", "end")
            assert int(row["observations"]) >= 1


def test_the_map_is_read_back_with_walls_near_the_true_ones(out: Path, trace: Trace) -> None:
    assert trace.scene is not None
    walls = read_map(out / "map.yaml", unknown="free")
    middles = walls.mean(axis=1)
    off = np.array([point_segment_distance(point, trace.scene.walls).min() for point in middles])
    assert off.max() < 0.12
    for a, b in trace.scene.walls:
        for point in a + np.linspace(0.1, 0.9, 9)[:, None] * (b - a):
            assert point_segment_distance(point, walls).min() < 0.12


@pytest.mark.parametrize("seed", range(5))
def test_a_map_keeps_its_cells_and_their_place(seed: int, tmp_path: Path) -> None:
    from PIL import Image

    rng = np.random.default_rng(seed)
    occupancy = rng.choice(np.array([-1, 0, 100], dtype=np.int8), size=(12, 20), p=[0.9, 0.05, 0.05])
    occupancy[5, 7] = 100
    write_map(tmp_path, occupancy, (-3.0, 2.0), 0.5)
    image = np.flipud(np.asarray(Image.open(tmp_path / "map.pgm")))
    rows, cols = np.nonzero(occupancy >= 0)
    part = occupancy[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    assert np.array_equal(image == 0, part == 100)
    assert np.array_equal(image == 254, part == 0)
    assert np.array_equal(image == 205, part == -1)
    corners = read_map(tmp_path / "map.yaml", unknown="free").reshape(-1, 2)
    assert np.all((corners - (-3.0, 2.0)) / 0.25 == np.round((corners - (-3.0, 2.0)) / 0.25))
    solid = np.argwhere(occupancy == 100)
    assert corners.min(axis=0) == pytest.approx(solid.min(axis=0)[::-1] * 0.5 + (-3.0, 2.0))
    assert corners.max(axis=0) == pytest.approx((solid.max(axis=0)[::-1] + 1) * 0.5 + (-3.0, 2.0))


def test_an_unknown_map_writes_no_image(tmp_path: Path) -> None:
    write_map(tmp_path, np.full((3, 3), -1, dtype=np.int8), (0.0, 0.0), 0.1)
    assert entries(tmp_path) == []


def test_until_it_is_finished_the_folder_is_called_partial_and_knows_its_configuration(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "deep" / "run", Config())
    assert entries(tmp_path) == ["deep", "deep/.run.lock", "deep/run.partial", "deep/run.partial/config.toml"]
    folder.finish()
    assert entries(tmp_path) == ["deep", "deep/run", "deep/run/config.toml"]


def test_the_rest_of_a_killed_run_makes_room_for_its_next_attempt(tmp_path: Path) -> None:
    for seed in (0, 1):
        (RunFolder(tmp_path / "run", Config(seed=seed)).partial / "estimate.tum").write_text(f"half of {seed}")
    folder = RunFolder(tmp_path / "run", Config(seed=2))
    assert folder.notes == [f"{folder.partial} of a killed run is kept as {tmp_path / 'run.2.partial'}"]
    assert entries(folder.partial) == ["config.toml"]
    assert load_config(folder.partial / "config.toml").seed == 2
    for seed in (0, 1):
        assert (tmp_path / f"run.{seed + 1}.partial" / "estimate.tum").read_text() == f"half of {seed}"
        assert load_config(tmp_path / f"run.{seed + 1}.partial" / "config.toml").seed == seed


def test_a_run_that_was_killed_before_its_first_scan_leaves_nothing_to_keep(tmp_path: Path) -> None:
    RunFolder(tmp_path / "run", Config())
    folder = RunFolder(tmp_path / "run", Config())
    assert folder.notes == [] and entries(tmp_path) == [".run.lock", "run.partial", "run.partial/config.toml"]


def finished(out: Path, seed: int) -> Path:
    """The folder of a run that has ended at once."""
    folder = RunFolder(out, Config(seed=seed))
    (folder.partial / "record.jsonl").write_text('{"format":1,"radius_m":0.2,"scene":null}\n')
    folder.finish()
    return out


def test_a_failure_leaves_the_old_folder_whole(tmp_path: Path, trace: Trace) -> None:
    finished(tmp_path / "run", 1)
    folder = RunFolder(tmp_path / "run", Config(seed=2), overwrite=True)
    broken = dataclasses.replace(trace, stamps_ns=trace.stamps_ns[:-1])
    with pytest.raises(ValueError):
        folder.write(broken, {})
    assert entries(tmp_path / "run") == ["config.toml", "record.jsonl"]
    assert load_config(tmp_path / "run" / "config.toml").seed == 1


def test_overwriting_puts_the_new_run_in_the_old_ones_place_and_touches_nothing_beside_it(tmp_path: Path) -> None:
    (tmp_path / "run.old").mkdir()
    (tmp_path / "run.old" / "mine").write_text("a copy that someone made")
    finished(tmp_path / "run", 1)
    RunFolder(tmp_path / "run", Config(seed=2), overwrite=True).finish()
    assert entries(tmp_path) == ["run", "run.old", "run.old/mine", "run/config.toml"]
    assert load_config(tmp_path / "run" / "config.toml").seed == 2


def test_what_is_no_run_is_neither_overwritten_nor_deleted(tmp_path: Path) -> None:
    for name in ("run", "run.partial"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "notes.txt").write_text("mine")
        with pytest.raises(FolderError, match=r"is not a run folder, it holds no config.toml of a run, allowed: "):
            RunFolder(tmp_path / "run", Config(), overwrite=True)
        assert entries(tmp_path / name) == ["notes.txt"]
        shutil.rmtree(tmp_path / name)
    (tmp_path / "run").write_text("a file")
    with pytest.raises(FolderError, match="is not a run folder"):
        RunFolder(tmp_path / "run", Config(), overwrite=True)
    with pytest.raises(FolderError, match=r"exists, allowed: a new folder, or --overwrite$"):
        RunFolder(tmp_path / "run", Config())


@pytest.mark.parametrize("name", ["", ".", "..", "/", "some/.."])
def test_a_path_without_a_name_of_its_own_is_refused(name: str) -> None:
    with pytest.raises(FolderError, match="allowed: a path that ends in a name"):
        RunFolder(Path(name), Config(), overwrite=True)


def test_a_file_whose_writing_is_interrupted_is_not_there(tmp_path):
    (tmp_path / "old.npz").write_text("of the run before")
    for name in ("new.npz", "old.npz"):
        with pytest.raises(KeyboardInterrupt), whole(tmp_path / name) as file:
            file.write_text("half of")
            raise KeyboardInterrupt
    assert [entry.name for entry in tmp_path.iterdir()] == ["old.npz"]
    assert (tmp_path / "old.npz").read_text() == "of the run before"


def test_a_run_killed_before_it_had_its_configuration_stops_no_later_run(tmp_path: Path) -> None:
    for leftover in ((), (".4242.config.toml",)):
        partial = tmp_path / "run.partial"
        partial.mkdir()
        for name in leftover:
            (partial / name).write_text("half of")
        with RunFolder(tmp_path / "run", Config()) as folder:
            assert folder.notes == [] and entries(partial) == ["config.toml"]
        (partial / "config.toml").unlink(missing_ok=True)
        partial.rmdir()
    (tmp_path / "run.partial" / ".4242.config.toml").mkdir(parents=True)
    with pytest.raises(FolderError, match="is not a run folder"):
        RunFolder(tmp_path / "run", Config())
