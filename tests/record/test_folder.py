import dataclasses
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
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace
from sixthsense.record.writing import FolderError
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
    *(f"stage_ms_mean.{s}" for s in ("sense", "ticks", "extract", "associate", "predict", "update", "grid", "plan")),
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


def test_trajectories_are_those_of_the_run_to_the_last_digit(out: Path, trace: Trace) -> None:
    truth, smoothed = tum(out / "truth.tum"), tum(out / "smoothed.tum")
    assert np.array_equal(truth[:, 1:3], np.array(trace.truths)[:, :2])
    headings = 2.0 * np.arctan2(truth[:, 6], truth[:, 7])
    assert wrap_angle(headings - np.array(trace.truths)[:, 2]) == pytest.approx(0.0, abs=1e-12)
    assert len(truth) == len(tum(out / "estimate.tum")) == len(trace.stamps_ns)
    assert len(smoothed) == len(trace.key_stamps_ns)
    assert set(smoothed[:, 0]) <= set(truth[:, 0])


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


def test_the_map_is_read_back_with_walls_near_the_true_ones(out: Path, trace: Trace) -> None:
    assert trace.scene is not None
    walls = read_map(out / "map.yaml", unknown="free")
    middles = walls.mean(axis=1)
    off = np.array([point_segment_distance(point, trace.scene.walls).min() for point in middles])
    assert off.max() < 0.12
    for a, b in trace.scene.walls:
        for point in a + np.linspace(0.1, 0.9, 9)[:, None] * (b - a):
            assert point_segment_distance(point, walls).min() < 0.12


def test_until_it_is_finished_the_folder_is_called_partial_and_knows_its_configuration(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "deep" / "run", Config())
    assert entries(tmp_path) == ["deep", "deep/.run.lock", "deep/run.partial", "deep/run.partial/config.toml"]
    folder.finish()
    assert entries(tmp_path) == ["deep", "deep/run", "deep/run/config.toml"]


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
