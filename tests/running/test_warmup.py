"""Where compiled kernels are kept, and what is said while they are compiled."""

import os
import stat
import sys
from pathlib import Path

import numba
import pytest

import sixthsense
from sixthsense.running import warmup


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A home and a temporary folder of this test's own; the package's folder cannot be written."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that what a test sets is taken back
    monkeypatch.delitem(sys.modules, "numba")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("os.access", lambda path, mode: path != tmp_path / "package")
    return tmp_path


def test_kernels_are_kept_in_a_new_folder_where_neither_package_nor_home_can_be_written(settings: Path) -> None:
    sixthsense._keep_kernels(settings / "package", settings)
    assert os.environ["NUMBA_CACHE_DIR"] == ""
    sixthsense._keep_kernels(settings / "package")
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.parent == settings and stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_only_a_compilation_is_told_and_only_once(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    known, *new = (numba.njit(lambda x, k=k: x + k) for k in range(3))
    known(1.0)
    monkeypatch.setattr(warmup, "warm_up", lambda: known(2.0))
    warmup.prepare(say=said.append)
    assert said == []
    monkeypatch.setattr(warmup, "warm_up", lambda: [kernel(2.0) for kernel in new])
    warmup.prepare(say=said.append)
    assert said == [warmup.COMPILING]
