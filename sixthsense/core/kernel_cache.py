"""Where Numba keeps compiled kernels if the folder of this package cannot be written, as in containers.

Numba keeps them beside the source, or else in the user's home, and raises an error when a kernel is defined if it can
write neither. It reads its settings when it is imported, so that the choice is made before.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any

_VARIABLE = "NUMBA_CACHE_DIR"

note = ""
"""one line for the user if neither the package's folder nor the home can be written"""


def choose_cache(package: Path) -> None:
    """Let Numba write its cache: beside the source in `package`, in the home, in a temporary folder, or not at all."""
    global note
    found = os.environ.get(_VARIABLE, "")
    if (found and _is_writable(Path(found))) or _is_writable(package / "__pycache__"):
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    folder: Path | None = home / "sixthsense"
    if not _is_writable(home):
        folder = _temporary_folder()
        place = "in memory, by every process anew" if folder is None else f"into {folder}"
        note = f"neither {package} nor {home} can be written: kernels are compiled {place} ({_VARIABLE} changes that)"
    if folder is None:
        _compile_in_memory()
        return
    _set(os.environ, folder, is_temporary=bool(note))


@functools.cache
def write_in_turn() -> bool:
    """Let processes that compile the same kernels write their caches in turn; whether that is possible here.

    Numba reads the list of a kernel's compiled forms, and writes it anew with one more before the form itself. Of two
    processes that do so at once, the later one's form would be found in place of the other's.
    """
    from numba.core.caching import IndexDataCacheFile

    save = IndexDataCacheFile.save
    try:
        with in_turn():
            pass
    except (ImportError, OSError):  # on Windows, and on some network drives
        return False

    def saved(file: Any, key: Any, data: Any) -> None:
        with in_turn():
            save(file, key, data)  # type: ignore[no-untyped-call]

    IndexDataCacheFile.save = saved  # type: ignore[method-assign]
    return True


@contextlib.contextmanager
def in_turn() -> Iterator[None]:
    """Hold the lock of the processes that write this package's kernels."""
    import fcntl

    folder = os.open(Path(__file__).parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def _set(environment: MutableMapping[str, str], folder: Path, is_temporary: bool) -> None:
    environment[_VARIABLE] = str(folder / "numba")
    if is_temporary:
        environment.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))  # it would warn, and search for fonts anew
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = environment[_VARIABLE]


def _is_writable(folder: Path) -> bool:
    """Whether files can be written into a folder, or into a new one of that name."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    can_be_asked = os.access in os.supports_effective_ids
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK, effective_ids=can_be_asked)


def _temporary_folder() -> Path | None:
    """A temporary folder that only this user can write, since what is in it will be executed; None if there is none."""
    import tempfile

    try:
        user = os.geteuid() if hasattr(os, "geteuid") else 0
        folder = Path(tempfile.gettempdir()) / f"sixthsense-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        is_own = os.name == "nt" or (found.st_uid == user and not found.st_mode & 0o077)
        return folder if is_own and _is_writable(folder) and not folder.is_symlink() else None
    except OSError:
        return None


def _compile_in_memory() -> None:
    from numba.core.dispatcher import Dispatcher

    def keep_nothing(dispatcher: Any) -> None:
        """In place of what makes a cache for a kernel."""

    Dispatcher.enable_caching = keep_nothing  # type: ignore[method-assign, assignment]
