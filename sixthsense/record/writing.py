"""Writing that others may see: files that are there as a whole or not at all, and a lock on a folder.

A run may be ended at any moment, also while it is saved, and two processes never write the same folder.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from sixthsense.config.errors import InputError


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
    """Holds `.NAME.lock` beside the folder `NAME`; a context manager.

    The operating system releases the lock of a process that was killed. The file is removed with the lock.
    """

    def __init__(self, folder: Path) -> None:
        """Take the lock, and create the folder's parents.

        Raises FolderInUseError if another process holds the lock, and OSError if the parents cannot be written.
        """
        from filelock import FileLock, Timeout

        place = folder.absolute()
        self._file = place.parent / f".{place.name}.lock"
        self._made = [parent for parent in place.parents if not parent.exists()]
        self._lock = FileLock(self._file, timeout=0, mode=0o666, thread_local=False)
        try:
            _make(place.parent)
            self._lock.acquire()
        except Timeout:
            raise FolderInUseError(
                "out", f"found another process that writes {folder}", "another folder, or wait for its end"
            ) from None
        except OSError as error:
            self._remove_made()
            error.filename = str(folder)
            raise

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the lock, and remove the parents that were created if nothing is in them."""
        if not self._lock.is_locked:
            return
        with contextlib.suppress(OSError):
            self._file.unlink()  # while it is held: who opened it before sees that it is gone, and tries again
        self._lock.release()
        self._remove_made()

    def _remove_made(self) -> None:
        with contextlib.suppress(OSError):  # not empty
            for parent in self._made:
                parent.rmdir()


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from None
