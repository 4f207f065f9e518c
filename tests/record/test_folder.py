import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config import Config, load_config, preset
from sixthsense.core.geometry import Array, point_segment_distance, wrap_angle
from sixthsense.evaluation.measure import measure
from sixthsense.figures.plot import save_map
from sixthsense.loop.run import run
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace
from sixthsense.record.writing import FolderError
from sixthsense.sources.ros_map import read_map

CORNERS = {"landmarks": "corners"}
CONFIG = preset(scene="rectangle", task="tour", max_time=15.0, seed=5, features=CORNERS)
RUN = ("run", "rectangle", "--task", "tour", "--max-time", "2")
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


pytestmark = pytest.mark.usefixtures("compiled")


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


def test_a_failure_leaves_the_old_folder_whole(tmp_path: Path, trace: Trace) -> None:
    old = RunFolder(tmp_path / "run", Config(seed=1))
    (old.partial / "record.jsonl").write_text('{"format":1,"radius_m":0.2,"scene":null}\n')
    old.finish()
    folder = RunFolder(tmp_path / "run", Config(seed=2), overwrite=True)
    broken = dataclasses.replace(trace, stamps_ns=trace.stamps_ns[:-1])
    with pytest.raises(ValueError):
        folder.write(broken, {})
    assert entries(tmp_path / "run") == ["config.toml", "record.jsonl"]
    assert seed_of(tmp_path / "run") == 1


def test_what_is_no_run_is_not_taken_for_a_killed_one(tmp_path: Path) -> None:
    (tmp_path / "run.partial").mkdir()
    (tmp_path / "run.partial" / "notes.txt").write_text("mine")
    with pytest.raises(FolderError, match=r"is not a run folder, it holds no config.toml of a run, allowed: "):
        RunFolder(tmp_path / "run", Config(), overwrite=True)
    assert entries(tmp_path / "run.partial") == ["notes.txt"]


# --- a run replaces an earlier run, and nothing else


def content(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def seed_of(folder: Path) -> int:
    return load_config(folder / "config.toml").seed


FOREIGN = {
    "cargo": {"config.toml": "[net]\n", "registry/index": "crates"},
    "saved settings": {"config.toml": "seed = 3\n[versions]\nsixthsense = '0.1'\n"},
    "notes": {"notes.txt": "mine"},
    "a figure": {"figures/mine.png": "mine"},
    "a second bag": {"bag/bag_1.mcap": "mine"},
    "a folder": {"more/": ""},
    "a folder named as a file": {"map.pgm/": ""},
}


@pytest.mark.parametrize("name", FOREIGN)
def test_what_no_run_has_written_is_never_removed(name, here, complaint):
    out = here / "x"
    if not name.startswith(("cargo", "saved")):
        ss.run("rectangle", task="tour", max_time=2.0, out=out)
        (out / "map.pgm").unlink()
    for file, text in FOREIGN[name].items():
        if file.endswith("/"):
            (out / file).mkdir(parents=True)
        else:
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            (out / file).write_text(text)
    before = content(here)
    said = complaint(*RUN, "--out", "x", "--overwrite")
    assert said.startswith("--out: x is not a run folder, it holds ") and "allowed: " in said
    assert content(here) == before


def test_the_second_of_two_runs_into_one_folder_is_told(here, complaint):
    with RunFolder(here / "x", Config(seed=1)) as first:
        said = complaint(*RUN, "--out", "x")
        assert said == "--out: found another process that writes x, allowed: another folder, or wait for its end"
        assert seed_of(first.partial) == 1
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert seed_of(here / "x") == 2


def test_what_a_killed_run_has_recorded_is_kept_under_another_name_and_the_user_is_told(here, capsys):
    ss.run("rectangle", task="tour", max_time=2.0, seed=1, out="x")
    (here / "x").rename(here / "x.partial")
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert "note: x.partial of a killed run is kept as x.1.partial\n" in capsys.readouterr().err
    assert (seed_of(here / "x"), seed_of(here / "x.1.partial")) == (2, 1)
    assert len(ss.load("x.1.partial").trace.estimates) > 10
    (here / "x.1.partial").rename(here / "y.partial")
    with pytest.warns(UserWarning, match=r"y.partial of a killed run is kept as y.1.partial"):
        ss.run("rectangle", task="tour", max_time=2.0, out="y")


def test_an_old_run_is_restored_where_the_new_one_cannot_take_its_name(here, monkeypatch):
    ss.run("rectangle", task="tour", max_time=2.0, seed=1, out="x")
    rename = Path.rename

    def failing(path: Path, target: Path) -> Path:
        if path.name == "x.partial":
            raise PermissionError(13, "Permission denied")
        return rename(path, target)

    with monkeypatch.context() as patch, pytest.raises(PermissionError):
        patch.setattr(Path, "rename", failing)
        ss.run("rectangle", task="tour", max_time=2.0, seed=2, out="x", overwrite=True)
    assert (seed_of(here / "x"), seed_of(here / "x.partial")) == (1, 2)
    assert sorted(path.name for path in here.iterdir()) == ["x", "x.partial"]


@pytest.mark.parametrize("new_has_its_name", [False, True])
def test_a_replacement_that_was_killed_is_completed_by_the_next_run(new_has_its_name, here):
    for name, seed in (("x" if new_has_its_name else "x.partial", 2), (".x.replaced", 1)):
        ss.run("rectangle", task="tour", max_time=2.0, seed=seed, out=here / name)
    if new_has_its_name:
        (here / ".x.replaced" / "config.toml").unlink()  # half removed
    folder = RunFolder(here / "x", Config(seed=3), overwrite=True)
    assert seed_of(here / "x") == (2 if new_has_its_name else 1)
    assert len(folder.notes) == (0 if new_has_its_name else 2)
    assert not (here / ".x.replaced").exists()
    assert (here / "x.1.partial").exists() is not new_has_its_name
