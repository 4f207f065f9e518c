import importlib
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TUM = "0.000000000 0 0 0 0 0 0 1\n0.100000000 0.5 0 0 0 0 0 1\n"
MEASURED = {"outcome": "explored", "ate_rmse_m": 0.0125, "nis_mean_per_dof": float("nan")}
CLOCKS = {"wall_time_s": 2.5, "realtime_factor": 40.0, "scan_ms_p99": 7.0, "stage_ms_mean.update": 0.5}


@pytest.fixture
def script(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("equality")


@pytest.fixture
def folders(tmp_path) -> tuple[Path, Path]:
    """Two with the same results, written one after the other."""
    for name in ("base", "new"):
        folder = tmp_path / name
        folder.mkdir()
        for trajectory in ("estimate.tum", "smoothed.tum"):
            (folder / trajectory).write_text(TUM)
        np.savez(folder / "landmarks.npz", **arrays())
        (folder / "metrics.json").write_text(json.dumps(MEASURED | CLOCKS))
    return tmp_path / "base", tmp_path / "new"


def arrays() -> dict[str, np.ndarray]:
    return {"ids": np.arange(2), "mean": np.array([0.5, 1.0, 0.1]), "covariance": np.eye(3)}


def test_the_same_results_are_equal_with_nan_among_them(script, folders):
    assert script.compare_folders(*folders) == []


def test_one_bit_of_an_array_is_a_difference(script, folders):
    changed = arrays()
    changed["mean"].view(np.uint64)[1] ^= 1
    np.savez(folders[1] / "landmarks.npz", **changed)
    (said,) = script.compare_folders(*folders)
    assert said == "landmarks.npz: mean: values differ by 2.22e-16 at most"


def test_minus_zero_is_not_zero(script, folders):
    changed = arrays()
    changed["covariance"][0, 1] = -0.0
    np.savez(folders[1] / "landmarks.npz", **changed)
    (said,) = script.compare_folders(*folders)
    assert said.startswith("landmarks.npz: covariance: ")


@pytest.mark.parametrize("ids", [np.arange(2, dtype=np.int32), np.arange(2).reshape(2, 1)])
def test_another_type_or_shape_is_a_difference(script, folders, ids):
    np.savez(folders[1] / "landmarks.npz", **(arrays() | {"ids": ids}))
    (said,) = script.compare_folders(*folders)
    assert said.startswith("landmarks.npz: ids: int64 (2,), now ")


def test_an_array_that_one_side_alone_has_is_a_difference(script, folders):
    np.savez(folders[1] / "landmarks.npz", **arrays(), kinds=np.zeros(2))
    assert script.compare_folders(*folders) == ["landmarks.npz: kinds: only in new"]
    assert script.compare_folders(*reversed(folders)) == ["landmarks.npz: kinds: only in base"]


def test_a_trajectory_says_where_it_parts_and_how_far(script, folders):
    (folders[1] / "estimate.tum").write_text(TUM.replace("0.5 0", "0.503 0.004"))
    (said,) = script.compare_folders(*folders)
    assert said == "estimate.tum: first differs in line 2, at most 0.005 m apart"


def test_a_trajectory_that_is_longer_differs_after_the_others_end(script, folders):
    (folders[1] / "smoothed.tum").write_text(TUM + TUM.splitlines()[1])
    (said,) = script.compare_folders(*folders)
    assert said == "smoothed.tum: first differs in line 3, 2 lines, now 3, at most 0 m apart"


@pytest.mark.parametrize("base", ["", "0 0\n0.1 0\n", TUM.replace(" 0.5 ", " five ")])
def test_a_trajectory_that_cannot_be_read_is_a_difference(script, folders, base):
    (folders[0] / "estimate.tum").write_text(base)
    (said,) = script.compare_folders(*folders)
    assert said.startswith("estimate.tum: ")


def test_a_metric_that_changed_shows_both_values(script, folders):
    (folders[1] / "metrics.json").write_text(json.dumps(MEASURED | CLOCKS | {"ate_rmse_m": 0.0126}))
    assert script.compare_folders(*folders) == ["metrics.json: ate_rmse_m: 0.0125, now 0.0126"]
    assert script.compare_folders(*folders, ignored=["ate_rmse_m"]) == []


def test_a_metric_that_one_side_alone_has_is_a_difference(script, folders):
    (folders[1] / "metrics.json").write_text(json.dumps(MEASURED | CLOCKS | {"plans": 3}))
    assert script.compare_folders(*folders) == ["metrics.json: plans: missing, now 3"]
    assert script.compare_folders(*reversed(folders)) == ["metrics.json: plans: 3, now missing"]


@pytest.mark.parametrize("key", CLOCKS)
def test_a_clock_may_change(script, folders, key):
    (folders[1] / "metrics.json").write_text(json.dumps(MEASURED | CLOCKS | {key: 1e3}))
    assert script.compare_folders(*folders) == []


@pytest.mark.parametrize("name", ["estimate.tum", "smoothed.tum", "landmarks.npz", "metrics.json"])
def test_a_missing_file_is_named(script, folders, name):
    (folders[1] / name).unlink()
    assert script.compare_folders(*folders) == [f"{name}: missing in new"]
    (folders[0] / name).unlink()
    assert script.compare_folders(*folders) == [f"{name}: missing in base and new"]
