"""The folder of a run: written as `OUT.partial`, renamed to `OUT` when it is complete."""

from __future__ import annotations

import csv
import itertools
import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config, save_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.record.contents import foreign_entries, has_record, reason_not_a_run, reason_not_started
from sixthsense.record.ending import write_arrays, write_grid
from sixthsense.record.factors import factor_graph, links_of, write_graph
from sixthsense.record.folder_lock import FolderError, FolderLock
from sixthsense.record.stream import write_end
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole


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

        The `OUT.partial` of a killed run is renamed, and `notes` say so. Raises FolderError if `out` exists and
        `overwrite` is false, if it is not a run's folder or another process writes it, and if it cannot be written.
        """
        if out.name in ("", ".."):
            raise FolderError(f"--out: found {str(out)!r}, allowed: a path that ends in a name")
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
            raise FolderError(
                f"--out: {self.partial} cannot be written ({error.strerror}), allowed: a new folder"
            ) from None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Leave nothing behind of a run that bad input or Ctrl-C has stopped before its first record; keep all else."""
        if kind is not None and issubclass(kind, (InputError, KeyboardInterrupt)) and not has_record(self.partial):
            shutil.rmtree(self.partial, ignore_errors=True)
        if isinstance(error, MemoryError):
            error.add_note(f"the record so far is in {self.partial}")
        self._lock.release()

    def _restore_replaced(self) -> None:
        """Complete a replacement that was killed half-way: the old run is restored, or removed if the new one is there.

        Raises FolderError if someone has written into the old run's folder.
        """
        if not os.path.lexists(self._replaced):
            return
        if not os.path.lexists(self.out):
            self._replaced.rename(self.out)
            self.notes.append(f"{self.out} was being replaced when a run was killed, and is restored")
            return
        foreign = next(foreign_entries(self._replaced), None)
        if foreign is not None:
            raise FolderError(f"--out: {self._replaced} holds {foreign}, which no run writes, allowed: move it away")
        shutil.rmtree(self._replaced)

    def _check_out(self) -> None:
        """Raise FolderError unless `out` is new, or is a run that may be replaced."""
        if not os.path.lexists(self.out):
            return
        if self.out.is_symlink():
            raise FolderError(f"--out: {self.out} is a symbolic link, allowed: a folder")
        if not self._overwrite:
            raise FolderError(f"--out: {self.out} exists, allowed: a new folder, or --overwrite")
        if reason := reason_not_a_run(self.out):
            raise _not_a_run(self.out, reason)

    def _keep_killed(self) -> None:
        """Rename the `.partial` of a killed run, unless it has recorded nothing; FolderError if it is not of a run."""
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
        try:
            self._write(trace, metrics)
        except OSError as error:
            error.filename = error.filename or str(self.partial)  # the error of a full disk names no file
            raise

    def _write(self, trace: Trace, metrics: Mapping[str, Any]) -> None:
        origin_ns = trace.stamps_ns[0] if trace.stamps_ns else 0
        write_tum(self.partial / "estimate.tum", trace.stamps_ns, np.array(trace.estimates), origin_ns)
        write_tum(self.partial / "smoothed.tum", trace.key_stamps_ns, trace.trajectory, origin_ns)
        if trace.truths:
            write_tum(self.partial / "truth.tum", trace.stamps_ns, np.array(trace.truths), origin_ns)
        write_landmarks(self.partial, trace)
        write_graph(self.partial, factor_graph(trace), links_of(trace))
        write_arrays(self.partial, trace)
        if trace.grid is not None:
            write_grid(self.partial, trace.grid)
            write_map(self.partial, trace.grid.occupancy(), trace.grid.origin, trace.config.grid.cell_m)
        if trace.outcome.startswith("explored"):
            write_places_left(self.partial / "places_left.csv", trace)
        with whole(self.partial / "metrics.json") as file:
            file.write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")
        write_end(self.partial, trace)

    def finish(self) -> None:
        """Rename the folder to `OUT`, replacing an existing run, and release it.

        The old run is moved aside until the new one has its name, and back if it cannot have it. Raises FolderError if
        `OUT` has meanwhile become something that may not be replaced; the new run then stays in `OUT.partial`.
        """
        try:
            self._check_out()
        except FolderError as error:
            raise FolderError(f"{error}; the run is in {self.partial}") from None
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


def _not_a_run(folder: Path, reason: str) -> FolderError:
    return FolderError(f"--out: {folder} is not a run folder, it {reason}, allowed: a new folder, or a run folder")


def write_tum(file: Path, stamps_ns: list[int], poses: Array, origin_ns: int) -> None:
    """Write (N, 3) poses as a TUM trajectory: stamp x y z qx qy qz qw, stamps in seconds since `origin_ns`.

    Stamps are relative because a double cannot resolve 1 ns in seconds since 1970.
    """
    with whole(file) as unfinished, unfinished.open("w", encoding="utf-8") as out:
        for stamp, (x, y, theta) in zip(stamps_ns, poses.reshape(-1, 3), strict=True):
            seconds, nanoseconds = divmod(stamp - origin_ns, 1_000_000_000)
            half = 0.5 * theta
            out.write(f"{seconds}.{nanoseconds:09d} {x:.17g} {y:.17g} 0 0 0 {np.sin(half):.17g} {np.cos(half):.17g}\n")


def write_places_left(file: Path, trace: Trace) -> None:
    """Write the unseen places of an exploration, the largest first: x and y in m, area in m^2, and the reason."""
    with whole(file) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["x", "y", "area_m2", "reason"])
        writer.writerows([place.x, place.y, place.area_m2, place.reason] for place in trace.left)


LANDMARK_COLUMNS = (
    "x", "y", "cov_xx", "cov_xy", "cov_yy", "alpha", "d", "cov_alpha_alpha", "cov_alpha_d", "cov_d_d"
)  # fmt: skip


def write_landmarks(folder: Path, trace: Trace) -> None:
    """Write `landmarks.csv`, and the joint mean and covariance as `landmarks.npz`."""
    estimate, records = trace.final, trace.records
    with whole(folder / "landmarks.csv") as file, file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["id", "kind", *LANDMARK_COLUMNS, "observations", "from_x", "from_y", "to_x", "to_y"])
        for k, i in enumerate(estimate.ids.tolist()):
            block = trace.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
            record = records[i]
            values = [*estimate.landmarks[k].tolist(), *map(float, (block[0, 0], block[0, 1], block[1, 1]))]
            # A point has x and y. A wall has alpha and d, and the extent of its seen part.
            columns = [""] * 5 + values if estimate.walls[k] else values + [""] * 5
            extent = record.extent.ravel().tolist() if estimate.walls[k] else [""] * 4
            writer.writerow([i, record.kind.name.lower(), *columns, record.observations, *extent])
    with whole(folder / "landmarks.npz") as file:
        np.savez(
            file,
            ids=estimate.ids,
            kinds=np.array([records[i].kind for i in estimate.ids.tolist()], dtype=np.int64),
            mean=np.concatenate([estimate.pose.array(), estimate.landmarks.ravel()]),
            covariance=trace.joint_cov,
        )


def write_map(folder: Path, occupancy: NDArray[np.int8], origin: tuple[float, float], cell_m: float) -> None:
    """Write (H, W) occupancy (-1 unknown, 0 free, 100 occupied) as map_server's PGM and YAML.

    The image is cropped to the known cells.
    """
    import yaml
    from PIL import Image

    known = occupancy >= 0
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if len(rows) == 0:
        return
    r0, c0 = int(rows[0]), int(cols[0])
    part = occupancy[r0 : rows[-1] + 1, c0 : cols[-1] + 1]
    grey = np.select([part == 100, part == 0], [0, 254], 205).astype(np.uint8)
    with whole(folder / "map.pgm") as file:
        Image.fromarray(np.flipud(grey)).save(file)  # the first row of an image is the top of the map
    meta = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": cell_m,
        "origin": [origin[0] + c0 * cell_m, origin[1] + r0 * cell_m, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    with whole(folder / "map.yaml") as file:
        file.write_text(yaml.safe_dump(meta, sort_keys=False), encoding="utf-8")
