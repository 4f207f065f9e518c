"""The tables of a campaign, one Parquet file per run, which pandas and pyarrow read as one table.

`rows/` has a row of metrics for each run, `curves/` a row for each of its keyframes.
"""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.campaigns.plan import AXES, CampaignError, import_extra
from sixthsense.campaigns.worker import CURVES
from sixthsense.evaluation.curves import Curves
from sixthsense.record.writing import whole

if TYPE_CHECKING:
    import pandas as pd

TEXTS = ("config_hash", *AXES, "front_end", "task", "host", "version", "outcome", "error")
"""text columns of every row; `error` is filled only for a failed run, which has no metrics"""

ORDER = (*AXES, "seed")
"""columns by which a frame is sorted"""

# Readers take the schema from the first file by name. This file has all columns and no row.
_COLUMNS = "all-columns.parquet"


class Rows:
    """The rows of one campaign, written by the driver alone; one file per run, so that no run has two rows."""

    def __init__(self, folder: Path) -> None:
        """Open `folder`/rows, which may be missing; raises CampaignError if it cannot be read."""
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
        """The errors along each run, by hash; none for a run that failed, or was made by an earlier version."""
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
            raise CampaignError(f"{self.folder}: cannot be read ({error}), allowed: the rows of a campaign") from None


def _cell(value: Any, kind: Any) -> Any:
    """A value converted to the type of its column; None if the types do not match."""
    if kind == "string":
        return None if value is None else str(value)
    number: Any = value if isinstance(value, numbers.Real) else None
    return number if number is None or kind == "int64" else float(number)
