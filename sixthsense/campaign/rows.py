"""The table of a campaign, one Parquet file per run: `rows/`, which pandas and pyarrow read as one, at any time."""

from __future__ import annotations

import io
import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.campaign.errors import CampaignError, needed
from sixthsense.campaign.folder import read_folder, write_whole
from sixthsense.campaign.plan import AXES

if TYPE_CHECKING:
    import pandas as pd

TEXTS = ("config_hash", *AXES, "task", "host", "version", "outcome", "error")
"""columns of text that every row has; the error is empty but for a run that has none of the metrics"""

ORDER = (*AXES, "seed")
"""of the rows of a frame"""

# Readers take the columns of all files from the first one by name, which holds no row.
_COLUMNS = "all-columns.parquet"


class Rows:
    """The rows of one campaign, written by the driver alone; a run has one file, so it cannot be there twice."""

    def __init__(self, folder: Path) -> None:
        """Open `folder`/rows, which need not exist; raises CampaignError for one that cannot be read."""
        self.folder = folder / "rows"
        self._arrow, self._parquet = needed("pyarrow"), needed("pyarrow.parquet")
        text, whole, real = self._arrow.string(), self._arrow.int64(), self._arrow.float64()
        columns = [*((name, text) for name in TEXTS), ("seed", whole), ("run_time_s", real)]
        self._schema = self._arrow.schema(columns)
        if (self.folder / _COLUMNS).is_file():
            self._schema = self._read(lambda: self._parquet.read_schema(self.folder / _COLUMNS))

    def known(self) -> list[dict[str, Any]]:
        """Of every row its hash, outcome, package version and what the campaign varies."""
        if not (self.folder / _COLUMNS).is_file():
            return []
        columns = ["config_hash", "outcome", "version", *ORDER]
        rows: list[dict[str, Any]] = self._read(lambda: self._table(columns)).to_pylist()
        return rows

    def frame(self) -> pd.DataFrame:
        """All rows, sorted by what the campaign varies; a metric that a run has not measured is NaN."""
        if not (self.folder / _COLUMNS).is_file():
            frame = self._schema.empty_table().to_pandas()
        else:
            frame = self._read(lambda: self._table(None)).to_pandas()
        return frame.sort_values(list(ORDER), ignore_index=True)

    def add(self, row: Mapping[str, Any]) -> None:
        """Write the row of one run, in place of the one it may have; raises OSError that names the file."""
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
        content = io.BytesIO()
        self._parquet.write_table(table, content)
        write_whole(self.folder / name, content.getvalue())

    def _table(self, columns: list[str] | None) -> Any:
        return needed("pyarrow.dataset").dataset(self.folder, format="parquet").to_table(columns=columns)

    def _read(self, read: Any) -> Any:
        try:
            return read()
        except (OSError, ValueError, KeyError) as error:  # Arrow's own errors are among them
            raise CampaignError(f"{self.folder}: cannot be read ({error}), allowed: the rows of a campaign") from None


def _cell(value: Any, kind: Any) -> Any:
    """A value as its column holds it; nothing where the column is of another kind."""
    if kind == "string":
        return None if value is None else str(value)
    number: Any = value if isinstance(value, numbers.Real) else None
    return number if number is None or kind == "int64" else float(number)


def load_campaign(folder: Path | str) -> pd.DataFrame:
    """The table of a campaign, running or over: a row per run, sorted by what it varies, metrics as columns.

    What a run has not measured is NaN; one that raised has the outcome "error" and the reason in the column `error`.
    Raises CampaignError for a folder that is no campaign's, and where pandas or pyarrow are missing.
    """
    folder = Path(folder)
    read_folder(folder)
    needed("pandas")
    return Rows(folder).frame()
