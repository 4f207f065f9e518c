"""Writing that others may see: files that are there as a whole or not at all, and a lock on a folder.

A run may be ended at any moment, also while it is saved, and two processes never write the same folder.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from sixthsense.config.errors import InputError

LOCK = ".lock"
"""file in a folder that a process is writing"""


@contextlib.contextmanager
def whole(file: Path) -> Iterator[Path]:
    """A path to write in place of `file`, which takes that name when the block has ended without an error.

    Raises OSError that names `file`, and then leaves nothing else behind.
    """
    # The name keeps its suffix, which np.savez would add.
    unfinished = file.with_name(f".{os.getpid()}.{file.name}")
    try:
        yield unfinished
        with unfinished.open("rb") as content:
            os.fsync(content.fileno())
        unfinished.replace(file)
    except BaseException as error:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(file)
        raise


@contextlib.contextmanager
def naming(file: Path) -> Iterator[None]:
    """A block whose OSError names this file if it names none, as that of a full disk."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(file)
        raise


class FolderInUseError(InputError):
    """A folder that another process is writing."""


class FolderLock:
    """Holds `.lock` in a folder, which it makes with its parents; a context manager.

    The operating system releases the lock of a process that has ended, whatever ended it.
    """

    def __init__(self, folder: Path) -> None:
        """Take the lock; raises FolderInUseError if another process has it, and OSError."""
        self.folder = folder
        """where the locked folder is, which may be renamed"""
        place = folder.absolute()
        self._made = [path for path in (place, *place.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / LOCK).open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_here = os.path.samestat(os.fstat(self._file.fileno()), (folder / LOCK).stat())
        except (BlockingIOError, FileNotFoundError):
            is_here = False
        if not is_here:  # locked, or renamed meanwhile by the process that had locked it
            self._file.close()
            found, allowed = f"found another process that writes {folder}", "another folder, or wait for its end"
            raise FolderInUseError("out", found, allowed)

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the lock, and remove the folder and the parents that were made if nothing is in them."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError):
            (self.folder / LOCK).unlink()
        self._file.close()
        for place in self._made:
            with contextlib.suppress(OSError):  # not empty
                place.rmdir()
