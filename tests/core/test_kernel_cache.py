"""A package that cannot be written, and a home that cannot be written: kernels are compiled all the same."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from sixthsense.core import kernel_cache
from sixthsense.core.kernel_cache import choose_cache

NOBODY = 65534
KERNEL = """
import numba
@numba.njit(cache=True)
def twice(x):
    return x + x
"""
PROGRAM = """
import os, tempfile
import numba  # what only root may read is loaded by root
numba.njit(lambda x: x + x)(1)
tempfile.tempdir = {temporary!r}
os.setgroups([])
os.setegid({user})
os.seteuid({user})
import sixthsense
from sixthsense.core import kernel_cache
import sixthsense.kernel as kernel
print(kernel_cache.note, kernel.twice(2), sum(kernel.twice.stats.cache_misses.values()), sep="|")
"""
VARIABLES = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME")


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A home and a temporary folder of this test's own, and none of the variables."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
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


def test_a_cache_that_the_user_chose_stays_if_it_can_be_written(settings, monkeypatch):
    forbid(monkeypatch, settings / "package", settings / "home", settings / "locked")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(settings / "mine"))
    choose_cache(settings / "package")
    assert os.environ["NUMBA_CACHE_DIR"] == str(settings / "mine") and kernel_cache.note == ""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(settings / "locked"))
    choose_cache(settings / "package")
    assert os.environ["NUMBA_CACHE_DIR"].startswith(str(settings / "tmp"))


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


@pytest.mark.parametrize("planted", ["open", "link", "file"])
def test_a_temporary_folder_that_others_can_write_is_not_used(planted, settings, monkeypatch):
    forbid(monkeypatch, settings / "package", settings / "home")
    folder = settings / "tmp" / f"sixthsense-{os.geteuid()}"
    if planted == "open":
        folder.mkdir()
        folder.chmod(0o777)
    elif planted == "link":
        (settings / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(settings / "elsewhere")
    else:
        folder.write_text("")
    monkeypatch.setattr(kernel_cache, "_compile_in_memory", lambda: None)
    choose_cache(settings / "package")
    assert "NUMBA_CACHE_DIR" not in os.environ
    assert "kernels are compiled in memory" in kernel_cache.note


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs root, to become another user")
@pytest.mark.parametrize("has_temporary", [True, False])
def test_a_user_without_a_home_can_compile_what_root_has_installed(has_temporary):
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        package, temporary = place / "site" / "sixthsense", place / "tmp"
        (package / "core").mkdir(parents=True)
        here = Path(kernel_cache.__file__).parents[1]
        shutil.copy(here / "core" / "kernel_cache.py", package / "core")
        shutil.copy(here / "__init__.py", package)
        (package / "__init__.pyi").write_text("")
        (package / "core" / "__init__.py").write_text("")
        (package / "kernel.py").write_text(KERNEL)
        temporary.mkdir()
        place.chmod(0o755)
        temporary.chmod(0o777 if has_temporary else 0o755)
        environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
        environment["PYTHONPATH"] = f"{place / 'site'}:{environment.get('PYTHONPATH', '')}"
        environment |= {"HOME": "/root", "PYTHONDONTWRITEBYTECODE": "1"}
        for misses in (1, 0):
            code = PROGRAM.format(temporary=str(temporary), user=NOBODY)
            done = subprocess.run(
                [sys.executable, "-c", code], env=environment, cwd=place, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            note, result, missed = done.stdout.strip().split("|")
            assert result == "4"
            if has_temporary:
                assert f"into {temporary / f'sixthsense-{NOBODY}'}" in note and missed == str(misses)
            else:
                assert "in memory, by every process anew" in note and missed == "1"
