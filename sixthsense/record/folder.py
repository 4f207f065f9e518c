"""The folder of a run: written as `OUT.partial`, renamed to `OUT` when it is complete."""

from __future__ import annotations

import itertools
import logging
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sixthsense.config import Config, save_config
from sixthsense.config.errors import InputError, PartError
from sixthsense.config.files import Note, read_table
from sixthsense.logs.runfolder import FILE
from sixthsense.record.exports import NAMES, write_files
from sixthsense.record.stream import RecordWriter
from sixthsense.record.trace import Trace
from sixthsense.record.writing import LOCK, FolderLock, naming, whole

_OWN = {"config.toml", FILE, LOCK, "figures", *NAMES}
"""what a run, its exports and its report write"""

_log = logging.getLogger(__name__)


class RunFolder:
    """Reserves a folder before the run and fills it; an existing run is replaced at the end."""

    def __init__(
        self, out: Path, config: Config, overwrite: bool = False, replayed: Note = None, prior_map: Note = None
    ) -> None:
        """Create `OUT.partial` with the configuration; `replayed` names the inputs of a replay, `prior_map` the map.

        An `OUT.partial` of a run that did not finish is renamed, which is logged. Raises InputError if `out` exists
        and `overwrite` is false, if it is not a run's folder or another process writes it, and if it cannot be written.
        """
        if out.name in ("", ".."):
            raise InputError("out", f"found {str(out)!r}", "a path that ends in a name")
        self.out = out
        self.partial = out.with_name(out.name + ".partial")
        self._overwrite = overwrite
        self.record = RecordWriter(self.partial / FILE)
        """a hook for the loop's `on_tick`"""
        try:
            self._check_out()
            self._lock = self._reserved()
            try:
                with whole(self.partial / "config.toml") as file:
                    save_config(config, file, replayed, prior_map)
            except BaseException as error:  # a signal's too, which comes before the block of the folder
                self.__exit__(type(error), error, None)
                raise
        except OSError as error:
            raise InputError("out", f"{self.partial} cannot be written ({error.strerror})", "a new folder") from None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Leave nothing behind of a run that was stopped before its first record; keep all else."""
        try:
            self.record.close()
        finally:
            if kind is not None and not has_record(self.partial):
                shutil.rmtree(self.partial, ignore_errors=True)
            elif isinstance(error, MemoryError | PartError):
                error.add_note(f"the record so far is in {self.partial}")
            self._lock.release()

    def _check_out(self, else_kept: str = "") -> None:
        """Raise InputError unless `out` is new, or a run that may be replaced; its message ends with `else_kept`."""
        if not os.path.lexists(self.out):
            return
        if not self._overwrite and not self.out.is_symlink():
            raise InputError("out", f"{self.out} exists", f"a new folder, or `overwrite`{else_kept}")
        _check_is_run(self.out, else_kept)

    def _reserved(self) -> FolderLock:
        """The lock on a new `OUT.partial`; what a run that did not finish has recorded there is moved away."""
        if os.path.lexists(self.partial) and not _is_just_made(self.partial):
            _check_is_run(self.partial)
        lock = FolderLock(self.partial)
        if not has_record(self.partial):
            return lock
        kept = lock.folder = self._numbered()
        self.partial.rename(kept)
        lock.release()
        _log.warning(f"note: {self.partial} of a run that did not finish is kept as {kept}")
        return self._reserved()

    def _numbered(self) -> Path:
        """The first unused path of `OUT.1.partial`, `OUT.2.partial`, ..."""
        numbered = (self.out.with_name(f"{self.out.name}.{number}.partial") for number in itertools.count(1))
        return next(place for place in numbered if not os.path.lexists(place))

    def write(self, trace: Trace, metrics: Mapping[str, Any]) -> None:
        """Write the end of the record, and all files of a finished run but the picture of its map.

        A trace whose ticks were not recorded is written as a whole. Raises OSError that names the file or folder.
        """
        with naming(self.partial):
            self.record.end(trace, metrics)  # first: a disk that is full after it costs what can be made again
            write_files(self.partial, trace, metrics)

    def finish(self) -> None:
        """Rename the folder to `OUT`, replacing an existing run, and release it.

        Files of the old one that no run writes are kept in `OUT`, which is logged. Raises InputError if `OUT` has
        meanwhile become something that may not be replaced; the new run then stays in `OUT.partial`.
        """
        self._check_out(f"; the run is in {self.partial}")
        kept, old = list[str](), self._numbered()
        if os.path.lexists(self.out):
            self.out.rename(old)
            kept = sorted(entry.name for entry in old.iterdir() if entry.name not in _OWN)
        self.partial.rename(self.out)
        for name in kept:
            (old / name).rename(self.out / name)
        shutil.rmtree(old, ignore_errors=True)
        self._lock.folder = self.out
        self._lock.release()
        if kept:
            _log.warning(f"note: kept in {self.out}, which it replaces: {', '.join(kept)}")


def _is_just_made(folder: Path) -> bool:
    """Whether a run was killed before it wrote its configuration: hidden files alone are there."""
    return not folder.is_symlink() and folder.is_dir() and all(file.name.startswith(".") for file in folder.iterdir())


def _check_is_run(folder: Path, else_kept: str = "") -> None:
    if reason := reason_not_a_run(folder):
        found = f"{folder} is not a run folder, it {reason}"
        raise InputError("out", found, f"a new folder, or a run folder{else_kept}")


def reason_not_a_run(folder: Path) -> str:
    """Why a path is not the folder of a run: "is a file or a link", "holds no config.toml of a run"; "" if it is.

    The configuration of a run names the version of this package.
    """
    if folder.is_symlink() or not folder.is_dir():
        return "is a file or a link"
    try:
        is_own = isinstance(read_table(folder / "config.toml")["versions"]["sixthsense"], str)
    except (InputError, LookupError, TypeError):
        is_own = False
    return "" if is_own else "holds no config.toml of a run"


def has_record(folder: Path) -> bool:
    """Whether a tick of a run has been recorded in the folder."""
    return (folder / FILE).is_file() and (folder / FILE).stat().st_size > 0
