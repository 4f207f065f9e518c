"""The folder of a campaign: `campaign.toml` with the axes and shared fields, and the rows of its runs.

`rows.jsonl` has a row of metrics for each run, a JSON object per line; `curves/` an NPZ file with the errors along it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import field_validator

from sixthsense.campaigns.engine import Rows
from sixthsense.campaigns.plan import ALWAYS, AXES, CampaignPlan, ranges, seed_range
from sixthsense.campaigns.worker import CURVES
from sixthsense.config import Section
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.files import instead_of, read_table
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


class Saved(Section):
    """The content of `campaign.toml`."""

    axes: dict[str, list[str]]
    """the values of each axis; seeds as ranges"""
    fields: dict[str, Any]
    """nested table that the runs share, without the axes"""
    scenes: dict[str, str]
    """the hash of each scene's content"""
    versions: dict[str, str]
    """of the package that made the runs"""

    @field_validator("axes")
    @classmethod
    def _complete(cls, axes: dict[str, list[str]]) -> dict[str, list[str]]:
        """InputError for an axis that is missing, and for seeds that are no ranges."""
        for axis in (*ALWAYS, "seeds"):
            if axis not in axes:
                raise InputError(axis, "found nothing", "a list of texts")
        for text in axes["seeds"]:
            seed_range(text)
        return axes


def check_folder(folder: Path, campaign: CampaignPlan) -> Saved | None:
    """Check the output folder and return its `campaign.toml`, or None for a new or empty folder.

    Raises InputError for a file, for a folder that is not a campaign's, and for a campaign by another version, with
    other shared fields or changed scenes. The axes may have other values: scenes, presets, parts, seeds can be added.
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
    if (version := saved.versions.get("sixthsense")) != __version__:
        raise InputError("out", f"{folder} has runs by version {version} of sixthsense", f"{__version__}; {allowed}")
    before, now = flat(saved.fields), flat(campaign.fields)
    for name in dict.fromkeys([*before, *now]):
        if before.get(name) != now.get(name):
            old, new = (shown(table[name]) if name in table else "the preset's" for table in (before, now))
            raise InputError("out", f"{folder} is a campaign with {name} = {old}, found {new}", allowed)
    for scene, digest in campaign.digests().items():
        if saved.scenes.get(scene, digest) != digest:
            raise InputError("out", f"the scene {scene} has changed since {folder} was created", allowed)
    return saved


def save_folder(folder: Path, campaign: CampaignPlan, saved: Saved | None) -> None:
    """Write `campaign.toml` atomically, with the axes of `saved` extended by those of the campaign.

    Raises OSError that names the file.
    """
    import tomli_w

    axes, scenes, seeds = campaign.axes(), campaign.digests(), list(campaign.seeds)
    if saved is not None:
        seeds += [seed for text in saved.axes["seeds"] for seed in seed_range(text)]
        both = {axis: [*saved.axes.get(axis, ()), *axes.get(axis, ())] for axis in {**saved.axes, **axes}}
        axes = {axis: list(dict.fromkeys(values)) for axis, values in both.items()} | {"seeds": ranges(seeds)}
        scenes = {**saved.scenes, **scenes}
    if saved is None or (axes, scenes) != (saved.axes, saved.scenes):
        table = {"axes": axes, "fields": campaign.fields, "scenes": scenes, "versions": {"sixthsense": __version__}}
        folder.mkdir(parents=True, exist_ok=True)
        with whole(folder / FILE) as file:
            file.write_bytes(tomli_w.dumps(table).encode())


def read_folder(folder: Path) -> Saved:
    """Read `campaign.toml`; raises InputError for a missing or damaged file."""
    file = folder / FILE
    if not file.is_file():
        raise InputError(folder, f"found {instead_of(folder, FILE)}", "the folder of a campaign")
    table = read_table(file)
    try:
        return Saved(**table)
    except InputError as error:
        raise error.within(file) from None


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
