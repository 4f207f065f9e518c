"""The folder of a campaign: `campaign.toml` with the axes and shared fields, and what its runs have come to.

`rows.jsonl` has a row of metrics for each run, a JSON object per line; `curves/` an NPZ file with the errors along it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.campaigns.engine import Rows
from sixthsense.campaigns.plan import ALWAYS, AXES, CampaignPlan, PlannedRun, ranges, seed_range
from sixthsense.campaigns.worker import CURVES
from sixthsense.config import as_table, merge, preset
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.files import instead_of
from sixthsense.config.section import shown
from sixthsense.config.version import __version__
from sixthsense.evaluation.curves import CURVES as COLUMNS
from sixthsense.evaluation.groups import flat
from sixthsense.record.writing import LOCK, whole

if TYPE_CHECKING:
    import pandas as pd

FILE, ROWS = "campaign.toml", "rows.jsonl"
TEXTS = ("config_hash", *AXES, "task", "host", "version", "outcome", "verdict", "error")
"""text columns of every row; `error` is filled only for a failed run, which has no metrics"""
NUMBERS = ("seed", "run_time_s")
"""number columns of every row"""
ORDER = (*AXES, "seed")
"""columns by which a frame is sorted"""


def check_folder(folder: Path, campaign: CampaignPlan) -> Mapping[str, Any] | None:
    """Check the output folder and return its `campaign.toml`, or None for a new or empty folder.

    Raises InputError for a file, for a folder that is not a campaign's, and for a campaign with other shared fields
    or changed scenes. The axes may have other values: scenes, presets, parts and seeds can be added.
    """
    allowed = "a new or empty folder, or that of this campaign"
    if folder.exists() and not folder.is_dir():
        raise InputError("out", f"{folder} is a file", allowed)
    if not folder.exists() or all(entry.name == LOCK for entry in folder.iterdir()):
        return None
    if not (folder / FILE).is_file():
        kind = "the folder of a run" if (folder / "config.toml").is_file() else "not a campaign folder"
        raise InputError("out", f"{folder} is {kind}", allowed)
    saved = read_folder(folder)
    before, now = flat(saved["fields"]), flat(_typed_fields(campaign))
    for name in dict.fromkeys([*before, *now]):
        if before.get(name) != now.get(name):
            old, new = (shown(table[name]) if name in table else "the preset's" for table in (before, now))
            raise InputError("out", f"{folder} is a campaign with {name} = {old}, found {new}", allowed)
    for scene, digest in campaign.digests().items():
        if saved["scenes"].get(scene, digest) != digest:
            raise InputError("out", f"the scene {scene} has changed since {folder} was created", allowed)
    return saved


def check_rows(folder: Path, runs: Mapping[str, PlannedRun], rows: Iterable[Mapping[str, Any]]) -> None:
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
        raise InputError(folder, f"found {instead_of(folder, FILE)}", allowed)
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


class CampaignRows:
    """The rows of one campaign, written by one process alone, and the curves of its runs."""

    def __init__(self, folder: Path) -> None:
        """Open the rows of a `folder`, which may be missing."""
        self.rows = Rows(folder / ROWS, "config_hash")
        """by the hash of their configuration"""
        self._curves = folder / CURVES

    def add(self, row: Mapping[str, Any]) -> None:
        """Write the row of one run and its curves, replacing older ones; raises OSError that names the file."""
        if (found := row.get(CURVES)) is not None:
            self._curves.mkdir(parents=True, exist_ok=True)
            columns = {name: found[name].to_numpy(np.float32) for name in COLUMNS}
            with whole(self._curves / f"run-{row['config_hash']}.npz") as file:
                np.savez_compressed(file, **columns)
        self.rows.add({name: value for name, value in row.items() if name != CURVES and value is not None})

    def frame(self) -> pd.DataFrame:
        """All rows, sorted by axes and seed; NaN where a run lacks the metric."""
        import pandas as pd

        rows = list(self.rows.read().values())
        names = dict.fromkeys([*TEXTS, *NUMBERS, *(name for row in rows for name in row)])
        frame = pd.DataFrame(rows, columns=list(names))
        return frame.sort_values(list(ORDER), ignore_index=True)

    def curves(self) -> dict[str, pd.DataFrame]:
        """The errors along each run, by hash; none for a run that failed. InputError for a damaged file."""
        import pandas as pd

        found = {}
        for file in sorted(self._curves.glob("run-*.npz")):
            try:
                with np.load(file) as columns:
                    values = {name: columns[name].astype(np.float64) for name in COLUMNS}
            except Exception as error:  # a damaged file makes its readers fail with undocumented exceptions
                raise InputError(file, f"cannot be read ({reason_of(error)})", "the curves of a run") from None
            found[file.stem.removeprefix("run-")] = pd.DataFrame(values)
        return found
