"""The folder of a run: written as `OUT.partial`, renamed to `OUT` when it is complete.

Only a folder that holds a run, and nothing else, may be replaced.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import stat
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sixthsense.config import Config, save_config
from sixthsense.config.errors import InputError, PartError
from sixthsense.record.exports import write_exports
from sixthsense.record.store import END_FILE, FILE, VERDICT_FILE, write_end, write_verdict
from sixthsense.record.trace import Trace
from sixthsense.record.writing import FolderLock, naming, whole

_FILES = frozenset(
    {
        "config.toml", FILE, END_FILE, "metrics.json", VERDICT_FILE, "audit.json", "places_left.csv",
        "estimate.tum", "smoothed.tum", "truth.tum", "landmarks.csv",
        "graph.g2o", "graph.npz", "map.pgm", "map.yaml",
        "bag/bag_0.mcap", "bag/metadata.yaml", "figures/report.html", "figures/animation.gif",
    }
)  # fmt: skip
"""files of a run and of its report, but for the figures"""
_FIGURES = frozenset({"map", "audit", "error", "rpe", "nees", "nis", "stages", "coverage", "exploration"})
"""names of the figures, without suffix"""

_FORMS = (".png", ".svg", ".pdf")
_FOLDERS = ("bag", "figures")
_RECORD_BEGINS = b'{"format":'


class RunFolder:
    """Reserves a folder before the run and fills it afterwards; an existing run is replaced at the end."""

    def __init__(
        self,
        out: Path,
        config: Config,
        overwrite: bool = False,
        replayed: Mapping[str, str] | None = None,
        prior_map: Mapping[str, Any] | None = None,
    ) -> None:
        """Create `OUT.partial` with the configuration; `replayed` names the inputs of a replay, `prior_map` the map.

        The `OUT.partial` of a killed run is renamed, and `notes` say so. Raises InputError if `out` exists and
        `overwrite` is false, if it is not a run's folder or another process writes it, and if it cannot be written.
        """
        if out.name in ("", ".."):
            raise InputError("out", f"found {str(out)!r}", "a path that ends in a name")
        self.out = out
        self.partial = out.with_name(out.name + ".partial")
        self.notes: list[str] = []
        """one line for the user about each earlier run that was moved"""
        self._replaced = out.with_name(f".{out.name}.replaced")
        self._overwrite = overwrite
        try:
            self._lock = FolderLock(out)
            try:
                self._restore_replaced()
                self._check_out()
                self._keep_killed()
                self.partial.mkdir()
                with whole(self.partial / "config.toml") as file:
                    save_config(config, file, replayed, prior_map)
            except BaseException:
                self._lock.release()
                raise
        except OSError as error:
            raise InputError("out", f"{self.partial} cannot be written ({error.strerror})", "a new folder") from None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Leave nothing behind of a run that bad input or Ctrl-C has stopped before its first record; keep all else."""
        if kind is not None and issubclass(kind, (InputError, KeyboardInterrupt)) and not has_record(self.partial):
            shutil.rmtree(self.partial, ignore_errors=True)
        if isinstance(error, MemoryError | PartError):
            error.add_note(f"the record so far is in {self.partial}")
        self._lock.release()

    def _restore_replaced(self) -> None:
        """Complete a replacement that was killed half-way: the old run is restored, or removed if the new one is there.

        Raises InputError if someone has written into the old run's folder.
        """
        if not os.path.lexists(self._replaced):
            return
        if not os.path.lexists(self.out):
            self._replaced.rename(self.out)
            self.notes.append(f"{self.out} was being replaced when a run was killed, and is restored")
            return
        foreign = next(foreign_entries(self._replaced), None)
        if foreign is not None:
            raise InputError("out", f"{self._replaced} holds {foreign}, which no run writes", "move it away")
        shutil.rmtree(self._replaced)

    def _check_out(self) -> None:
        """Raise InputError unless `out` is new, or is a run that may be replaced."""
        if not os.path.lexists(self.out):
            return
        if self.out.is_symlink():
            raise InputError("out", f"{self.out} is a symbolic link", "a folder")
        if not self._overwrite:
            raise InputError("out", f"{self.out} exists", "a new folder, or `overwrite`")
        if reason := reason_not_a_run(self.out):
            raise _not_a_run(self.out, reason)

    def _keep_killed(self) -> None:
        """Rename the `.partial` of a killed run, unless it has recorded nothing; InputError if it is not of a run."""
        if not os.path.lexists(self.partial):
            return
        if _is_just_made(self.partial):
            shutil.rmtree(self.partial)
            return
        if reason := reason_not_started(self.partial):
            raise _not_a_run(self.partial, reason)
        if [file.name for file in self.partial.iterdir()] == ["config.toml"]:
            shutil.rmtree(self.partial)
            return
        numbered = (self.out.with_name(f"{self.out.name}.{number}.partial") for number in itertools.count(1))
        kept = next(place for place in numbered if not os.path.lexists(place))
        self.partial.rename(kept)
        self.notes.append(f"{self.partial} of a killed run is kept as {kept}")

    def write(self, trace: Trace, metrics: Mapping[str, Any]) -> None:
        """Write all files of a finished run but the figures.

        A record that was not streamed during the run is written completely. Raises OSError that names the file or the
        folder if it cannot be written.
        """
        with naming(self.partial):
            write_end(self.partial, trace)  # first: a disk that is full after it costs what can be made again
            if trace.verdict is not None:
                write_verdict(self.partial / VERDICT_FILE, trace.verdict)
            write_exports(self.partial, trace, metrics)

    def finish(self) -> None:
        """Rename the folder to `OUT`, replacing an existing run, and release it.

        The old run is moved aside until the new one has its name, and back if it cannot have it. Raises InputError if
        `OUT` has meanwhile become something that may not be replaced; the new run then stays in `OUT.partial`.
        """
        try:
            self._check_out()
        except InputError as error:
            raise InputError(error.where, error.found, f"{error.allowed}; the run is in {self.partial}") from None
        if os.path.lexists(self.out):
            self.out.rename(self._replaced)
            try:
                self.partial.rename(self.out)
            except BaseException:
                self._replaced.rename(self.out)
                raise
            shutil.rmtree(self._replaced, ignore_errors=True)
        else:
            self.partial.rename(self.out)
        self._lock.release()


def _is_just_made(folder: Path) -> bool:
    """Whether a run was killed before it wrote its configuration."""
    return (
        not folder.is_symlink()
        and folder.is_dir()
        and all(re.fullmatch(r"\.\d+\.config\.toml", file.name) and not file.is_dir() for file in folder.iterdir())
    )


def _not_a_run(folder: Path, reason: str) -> InputError:
    return InputError("out", f"{folder} is not a run folder, it {reason}", "a new folder, or a run folder")


def reason_not_a_run(folder: Path) -> str:
    """Why a path is not the folder of one run and nothing else: "is a file", "holds notes.txt"; "" if it is."""
    if reason := reason_not_started(folder):
        return reason
    if not has_record(folder):
        return "holds no record of a run"
    foreign = next(foreign_entries(folder), None)
    return "" if foreign is None else f"holds {foreign}, which no run writes"


def reason_not_started(folder: Path) -> str:
    """Why no run has begun in this path: "is a file", "holds no config.toml of a run"; "" if one has."""
    if folder.is_symlink():
        return "is a symbolic link"
    if not folder.is_dir():
        return "is a file"
    return "" if _is_configuration(folder / "config.toml") else "holds no config.toml of a run"


def has_record(folder: Path) -> bool:
    """Whether a tick of a run has been recorded in the folder."""
    try:
        with (folder / FILE).open("rb") as stream:
            return stream.read(len(_RECORD_BEGINS)) == _RECORD_BEGINS
    except OSError:
        return False


def foreign_entries(folder: Path) -> Iterator[str]:
    """The paths within a folder, relative to it, that neither a run nor its report writes."""
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        if entry.name in _FOLDERS and entry.is_dir(follow_symlinks=False):
            yield from (
                f"{entry.name}/{inner.name}" for inner in os.scandir(entry.path) if not _is_known(inner, entry.name)
            )
        elif not _is_known(entry):
            yield entry.name


def _is_known(entry: os.DirEntry[str], within: str = "") -> bool:
    if not entry.is_file(follow_symlinks=False):
        return False
    file = Path(entry.name)
    is_figure = within == "figures" and file.stem in _FIGURES and file.suffix in _FORMS
    return is_figure or (f"{within}/{entry.name}" if within else entry.name) in _FILES


def _is_configuration(file: Path) -> bool:
    """Whether a file is a configuration that a run saved: it names the version of this package that ran it."""
    try:
        if not stat.S_ISREG(file.lstat().st_mode):
            return False
        versions = tomllib.loads(file.read_text(encoding="utf-8-sig")).get("versions")
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(versions, dict) and isinstance(versions.get("sixthsense"), str)
