"""What is compiled before a run, and whether it was compiled before."""

import contextlib
import gc
import time
from pathlib import Path

import numba
import pytest

from sixthsense.config import Config, preset
from sixthsense.core import kernel_cache
from sixthsense.running import warmup

MATCHING = preset("log")
GUIDED = preset(estimator="isam2", association={"proposed_by": "scan-matching"})

WHAT = [
    (None, False, True, {"all"}), (None, False, False, {"drive"}),
    (Config(), False, True, {"all"}), (Config(), True, False, {"drive"}),
    (MATCHING, False, True, {"all", "scans"}), (MATCHING, False, False, {"drive", "scans"}),
    (MATCHING, True, True, {"scans"}), (MATCHING, True, False, {"scans"}),
    (GUIDED, True, False, {"drive", "scans"}),
]  # fmt: skip
"""configuration, whether a log is replayed, whether it is the first time, and what is compiled"""


@pytest.mark.parametrize(("config", "of_log", "is_first", "expected"), WHAT)
def test_a_run_compiles_what_it_needs(config, of_log, is_first, expected, monkeypatch) -> None:
    done, said, beside, asked = set(), [], [], []
    for name, part in {"warm_up": "all", "_warm_up_drive": "drive", "warm_up_scans": "scans"}.items():
        monkeypatch.setattr(warmup, name, lambda part=part: done.add(part))
    monkeypatch.setattr(warmup, "is_compiled", lambda *parts: asked.append(parts) or not is_first)
    monkeypatch.setattr(warmup, "_second_process", lambda *parts: beside.append(parts) or contextlib.nullcontext())
    monkeypatch.setattr(kernel_cache, "note", "")
    warmup.prepare(said.append, config, of_log)
    assert done == expected and said == [warmup.COMPILING] * is_first
    assert asked == [(bool(expected & {"all", "drive"}), "scans" in expected)]
    assert beside == [(bool(expected & {"all", "drive"}), "scans" in expected)] * is_first


def test_a_second_process_compiles_until_the_first_has_what_it_needs(tmp_path: Path, monkeypatch) -> None:
    """It is this package's, its kernels are found where this process looks for them, and it does not outlive it."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(warmup.os, "cpu_count", lambda: 2)
    with warmup._second_process(False, True):
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.rglob("*.nbc")) and time.monotonic() < deadline:
            time.sleep(0.05)
    kept = {path.name for path in tmp_path.rglob("*.nbc")}
    assert kept
    time.sleep(0.5)
    assert {path.name for path in tmp_path.rglob("*.nbc")} == kept


def test_one_processor_compiles_in_one_process(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(warmup.os, "cpu_count", lambda: 1)
    monkeypatch.setattr(warmup.subprocess, "Popen", None)
    with warmup._second_process(True, True):
        pass


@pytest.mark.parametrize("has_own_cache", [True, False])
def test_the_kernels_are_looked_for_where_numba_keeps_them(has_own_cache, tmp_path: Path, monkeypatch) -> None:
    package = tmp_path / "lib" / "package"
    own = tmp_path / "cache"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(own) if has_own_cache else "")
    monkeypatch.setattr(warmup, "__file__", str(package / "running" / "warmup.py"))
    elsewhere, there = (package, own) if has_own_cache else (own, package)
    for place, expected in ((elsewhere, False), (tmp_path / "lib", False), (there / "core" / "__pycache__", True)):
        place.mkdir(parents=True, exist_ok=True)
        (place / "frontier.close_unseen_gaps-7.nbi").touch()
        assert warmup.is_compiled() is expected
        assert not warmup.is_compiled(True, True) and not warmup.is_compiled(False, True)
    (there / "tracking.track-9.nbi").touch()
    assert warmup.is_compiled(True, True) and warmup.is_compiled(False, True)


def test_collections_in_a_run_do_not_walk_the_imports() -> None:
    gc.unfreeze()
    warmup._keep_imports()
    assert gc.get_freeze_count() > 10_000
