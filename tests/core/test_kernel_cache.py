"""A package that cannot be written, and a home that cannot be written: kernels are compiled all the same."""

import os
import stat
import sys
import threading
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

from sixthsense.core import kernel_cache
from sixthsense.core.kernel_cache import choose_cache

VARIABLES = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME")


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A home and a temporary folder of this test's own, and none of the variables."""
    for name in VARIABLES:
        monkeypatch.setenv(name, "")  # so that what a test sets is taken back, whether it was set before or not
        monkeypatch.delenv(name)
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(kernel_cache, "note", "")
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    return tmp_path


def forbid(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    writable = kernel_cache._is_writable
    monkeypatch.setattr(
        kernel_cache, "_is_writable", lambda at: not any(at.is_relative_to(f) for f in folders) and writable(at)
    )


def test_where_the_package_can_be_written_nothing_is_set(settings):
    choose_cache(settings)
    assert "NUMBA_CACHE_DIR" not in os.environ and kernel_cache.note == ""


def test_a_package_that_cannot_be_written_is_cached_in_the_home(settings, monkeypatch):
    forbid(monkeypatch, settings / "package")
    choose_cache(settings / "package")
    assert os.environ["NUMBA_CACHE_DIR"] == str(settings / "home" / ".cache" / "sixthsense" / "numba")
    assert kernel_cache.note == "" and "MPLCONFIGDIR" not in os.environ


def test_without_a_home_the_cache_is_in_a_temporary_folder_of_the_user_alone_and_one_line_says_so(
    settings, monkeypatch
):
    forbid(monkeypatch, settings / "package", settings / "home")
    choose_cache(settings / "package")
    folder = settings / "tmp" / f"sixthsense-{os.geteuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder / "numba")
    assert os.environ["MPLCONFIGDIR"] == str(folder / "matplotlib")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert f"kernels are compiled into {folder}" in kernel_cache.note and "\n" not in kernel_cache.note


def test_a_kernel_is_written_when_no_other_process_writes(tmp_path) -> None:
    """Else the list of a kernel's compiled forms that one process has read would replace what the other has written."""
    pytest.importorskip("fcntl")
    assert kernel_cache.write_in_turn() and kernel_cache.write_in_turn()  # again, without waiting for itself
    of_kernel = IndexDataCacheFile(str(tmp_path), "kernel", ("source", 7))
    writing = threading.Thread(target=of_kernel.save, args=("float64", b"compiled"))
    with kernel_cache.in_turn():
        writing.start()
        writing.join(timeout=0.3)
        assert of_kernel.load("float64") is None
    writing.join()
    assert of_kernel.load("float64") == b"compiled"
