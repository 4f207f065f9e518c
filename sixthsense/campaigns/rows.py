"""The table of a campaign: `rows/`, one Parquet file per run, which pandas and pyarrow read as one table."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.campaigns.errors import CampaignError, import_extra
from sixthsense.campaigns.folder import read_folder
from sixthsense.campaigns.plan import AXES
from sixthsense.record.writing import whole

if TYPE_CHECKING:
    import pandas as pd

TEXTS = ("config_hash", *AXES, "task", "host", "version", "outcome", "error")
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
        """Write the row of one run, replacing an older one; raises OSError that names the file."""
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

    def _write(self, name: str, table: Any) -> None:
        with whole(self.folder / name) as file:
            self._parquet.write_table(table, file)

    def _table(self, columns: list[str] | None) -> Any:
        return import_extra("pyarrow.dataset").dataset(self.folder, format="parquet").to_table(columns=columns)

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


def load_campaign(folder: Path | str) -> pd.DataFrame:
    """Load the table of a running or finished campaign: a row per run, metrics as columns, sorted by axes and seed.

    A metric that a run lacks is NaN. A run that raised has the outcome "error" and the reason in the column `error`.
    Raises CampaignError for a folder that is not a campaign's, and if pandas or pyarrow is missing.
    """
    folder = Path(folder)
    read_folder(folder)
    import_extra("pandas")
    return Rows(folder).frame()
