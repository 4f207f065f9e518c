"""The folder of a campaign: `campaign.toml` with the axes and shared fields, and Parquet tables, a file per run.

`rows/` has a row of metrics for each run, `curves/` a row for each of its keyframes; pandas and pyarrow read either as
one table.
"""

from __future__ import annotations

import dataclasses
import numbers
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.campaigns.plan import ALWAYS, AXES, CampaignPlan, PlannedRun, import_extra, ranges, seed_range
from sixthsense.campaigns.worker import CURVES
from sixthsense.config import as_table, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.config.version import __version__
from sixthsense.evaluation.curves import Curves
from sixthsense.record.writing import whole

if TYPE_CHECKING:
    import pandas as pd

FILE = "campaign.toml"
TEXTS = ("config_hash", *AXES, "task", "host", "version", "outcome", "verdict", "error")
"""text columns of every row; `error` is filled only for a failed run, which has no metrics"""

ORDER = (*AXES, "seed")
"""columns by which a frame is sorted"""

# Readers take the schema from the first file by name. This file has all columns and no row.
_COLUMNS = "all-columns.parquet"


def check_folder(folder: Path, campaign: CampaignPlan) -> Mapping[str, Any] | None:
    """Check the output folder and return its `campaign.toml`, or None for a new or empty folder.

    Raises InputError for a file, for a folder that is not a campaign's, and for a campaign with other shared fields
    or changed scenes. The axes may have other values: scenes, presets, parts and seeds can be added.
    """
    allowed = "a new or empty folder, or that of this campaign"
    if folder.exists() and not folder.is_dir():
        raise InputError("out", f"{folder} is a file", allowed)
    if not folder.exists() or not any(folder.iterdir()):
        return None
    if not (folder / FILE).is_file():
        kind = "the folder of a run" if (folder / "config.toml").is_file() else "not a campaign folder"
        raise InputError("out", f"{folder} is {kind}", allowed)
    saved = read_folder(folder)
    before, now = dict(_flatten(saved["fields"])), dict(_flatten(_typed_fields(campaign)))
    for name in dict.fromkeys([*before, *now]):
        if before.get(name) != now.get(name):
            old, new = (shown(table[name]) if name in table else "the preset's" for table in (before, now))
            raise InputError("out", f"{folder} is a campaign with {name} = {old}, found {new}", allowed)
    for scene, digest in campaign.digests().items():
        if saved["scenes"].get(scene, digest) != digest:
            raise InputError("out", f"the scene {scene} has changed since {folder} was created", allowed)
    return saved


def check_rows(folder: Path, runs: Mapping[str, PlannedRun], rows: list[dict[str, Any]]) -> None:
    """Raise InputError if the folder has a row of a planned run with another configuration.

    A preset or a default value that differs between two versions of the package is the usual cause.
    """
    hashes = {tuple(run.axes().values()): key for key, run in runs.items()}
    for row in rows:
        values = tuple(row[name] for name in (*AXES, "seed"))
        if hashes.get(values, row["config_hash"]) != row["config_hash"]:
            raise InputError(
                "out",
                f"{folder} has the run {' '.join(map(str, values))} with another configuration, from version "
                f"{row['version']} of the package",
                "another folder",
            )


def save_folder(folder: Path, campaign: CampaignPlan, saved: Mapping[str, Any] | None) -> None:
    """Write `campaign.toml` atomically, with the axes of `saved` extended by those of the campaign.

    Raises OSError that names the file.
    """
    import tomli_w

    axes = campaign.axes()
    scenes = campaign.digests()
    if saved is not None:
        seeds = [seed for text in saved["axes"]["seeds"] for seed in seed_range(text)]
        axes = {axis: list(dict.fromkeys([*saved["axes"].get(axis, ()), *values])) for axis, values in axes.items()}
        axes = {**saved["axes"], **axes}
        axes["seeds"] = ranges([*seeds, *campaign.seeds])
        scenes = {**saved["scenes"], **scenes}
    if saved is None or (axes, scenes) != (saved["axes"], saved["scenes"]):
        table = {
            "axes": axes,
            "fields": _typed_fields(campaign),
            "scenes": scenes,
            "versions": {"sixthsense": __version__},
        }
        folder.mkdir(parents=True, exist_ok=True)
        with whole(folder / FILE) as file:
            file.write_bytes(tomli_w.dumps(table).encode())


def read_folder(folder: Path) -> Mapping[str, Any]:
    """Read `campaign.toml` as a table; raises InputError for a missing or damaged file."""
    file = folder / FILE
    allowed = "the folder of a campaign"
    if not file.is_file():
        found = f"no {FILE} in it" if folder.is_dir() else "a file" if folder.exists() else "no such folder"
        raise InputError(folder, f"found {found}", allowed)
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(file, f"is not TOML ({error})", allowed) from None
    for name in ("axes", "fields", "scenes"):
        if not isinstance(table.get(name), dict):
            raise InputError(file, f"{name}: found no such table", allowed)
    for axis in dict.fromkeys((*ALWAYS, "seeds", *table["axes"])):
        values = table["axes"].get(axis)
        if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
            raise InputError(file, f"axes.{axis}: found {shown(values)}", "a list of texts")
    try:
        for text in table["axes"]["seeds"]:
            seed_range(text)
    except InputError as error:
        raise error.at(f"{file}: axes.{error.where}") from None
    return table


def _typed_fields(campaign: CampaignPlan) -> dict[str, Any]:
    """The shared fields with the types of the configuration: numbers of the field's type, lists for tuples."""

    def select(table: Mapping[str, Any], names: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: select(table[name], value) if isinstance(value, Mapping) else _plain(table[name])
            for name, value in sorted(names.items())
            if name in table
        }

    return select(as_table(merge(preset(campaign.values["preset"][0]), campaign.fields)), campaign.fields)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _flatten(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{path}{name}.")
        else:
            yield path + name, value


class Rows:
    """The rows of one campaign, written by the driver alone; one file per run, so that no run has two rows."""

    def __init__(self, folder: Path) -> None:
        """Open `folder`/rows, which may be missing; raises InputError if it cannot be read."""
        self.folder = folder / "rows"
        self._curves = folder / CURVES
        self._arrow, self._parquet = import_extra("pyarrow"), import_extra("pyarrow.parquet")
        text, integer, real = self._arrow.string(), self._arrow.int64(), self._arrow.float64()
        columns = [*((name, text) for name in TEXTS), ("seed", integer), ("run_time_s", real)]
        self._schema = self._arrow.schema(columns)
        if (self.folder / _COLUMNS).is_file():
            self._schema = self._read(lambda: self._parquet.read_schema(self.folder / _COLUMNS))

    def summaries(self) -> list[dict[str, Any]]:
        """The hash, outcome, package version, axes and seed of every row."""
        if not (self.folder / _COLUMNS).is_file():
            return []
        columns = ["config_hash", "outcome", "version", *ORDER]
        rows: list[dict[str, Any]] = self._read(lambda: self._table(columns)).to_pylist()
        return rows

    def frame(self) -> pd.DataFrame:
        """All rows, sorted by axes and seed; NaN where a run lacks the metric."""
        if not (self.folder / _COLUMNS).is_file():
            frame = self._schema.empty_table().to_pandas()
        else:
            frame = self._read(lambda: self._table(None)).to_pandas()
        return frame.sort_values(list(ORDER), ignore_index=True)

    def add(self, row: Mapping[str, Any]) -> None:
        """Write the row of one run and its curves, replacing older ones; raises OSError that names the file."""
        if isinstance(found := row.get(CURVES), Curves):
            self._write_curves(row["config_hash"], found)
        row = {name: value for name, value in row.items() if name != CURVES}
        values = {name: value for name, value in row.items() if value is not None}
        kinds = {
            name: self._arrow.float64() if isinstance(value, numbers.Real) else self._arrow.string()
            for name, value in values.items()
        }
        new = [(name, kind) for name, kind in kinds.items() if name not in self._schema.names]
        self.folder.mkdir(parents=True, exist_ok=True)
        if new or not (self.folder / _COLUMNS).is_file():
            for name, kind in new:
                self._schema = self._schema.append(self._arrow.field(name, kind))
            self._write(_COLUMNS, self._schema.empty_table())
        cells = {field.name: [_cell(values.get(field.name), field.type)] for field in self._schema}
        self._write(f"run-{values['config_hash']}.parquet", self._arrow.table(cells, schema=self._schema))

    def curves(self) -> dict[str, Curves]:
        """The errors along each run, by hash; none for a run that failed."""
        if not any(self._curves.glob("run-*.parquet")):
            return {}
        table = self._read(lambda: self._table(None, self._curves)).to_pandas()
        names = [field.name for field in dataclasses.fields(Curves)]
        return {
            str(key): Curves(*(group[name].to_numpy(dtype=np.float64) for name in names))
            for key, group in table.groupby("config_hash", sort=False)
        }

    def _write_curves(self, key: str, curves: Curves) -> None:
        self._curves.mkdir(parents=True, exist_ok=True)
        columns = {field.name: getattr(curves, field.name).astype(np.float32) for field in dataclasses.fields(curves)}
        table = self._arrow.table({"config_hash": [key] * len(curves.time_s), **columns})
        with whole(self._curves / f"run-{key}.parquet") as file:
            self._parquet.write_table(table, file)

    def _write(self, name: str, table: Any) -> None:
        with whole(self.folder / name) as file:
            self._parquet.write_table(table, file)

    def _table(self, columns: list[str] | None, folder: Path | None = None) -> Any:
        dataset = import_extra("pyarrow.dataset").dataset(folder or self.folder, format="parquet")
        return dataset.to_table(columns=columns)

    def _read(self, read: Any) -> Any:
        try:
            return read()
        except (OSError, ValueError, KeyError) as error:  # base classes of Arrow's errors
            raise InputError(self.folder, f"cannot be read ({error})", "the rows of a campaign") from None


def _cell(value: Any, kind: Any) -> Any:
    """A value converted to the type of its column; None if the types do not match."""
    if kind == "string":
        return None if value is None else str(value)
    number: Any = value if isinstance(value, numbers.Real) else None
    return number if number is None or kind == "int64" else float(number)
