"""The folder of a campaign: `campaign.toml` with the shared fields, and the rows of its runs.

`rows.jsonl` has a row of metrics for each run, a JSON object per line; `curves/` an NPZ file with the errors along it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.campaigns.engine import Rows
from sixthsense.campaigns.plan import AXES, CURVES, CampaignPlan
from sixthsense.config import Section
from sixthsense.config.errors import InputError
from sixthsense.config.files import instead_of, read_table
from sixthsense.config.section import shown
from sixthsense.config.version import __version__
from sixthsense.evaluation.curves import CURVES as COLUMNS
from sixthsense.evaluation.groups import LABELS, flat
from sixthsense.logs.runfolder import readable
from sixthsense.record.writing import LOCK, whole

if TYPE_CHECKING:
    import pandas as pd

FILE, ROWS = "campaign.toml", "rows.jsonl"
TEXTS = ("config_hash", *AXES, "task", "host", "version", "outcome", "verdict", "error")
"""text columns of every row; `error` is filled only for a failed run, which has no metrics"""


class Saved(Section):
    """The content of `campaign.toml`: what all runs of a campaign have in common."""

    fields: dict[str, Any]
    """nested table that the runs share, without the axes"""
    scenes: dict[str, str]
    """the hash of each scene's content"""
    versions: dict[str, str]
    """of the package that made the runs"""


def check_folder(folder: Path, campaign: CampaignPlan) -> Saved:
    """Check the output folder and return its `campaign.toml` with the scenes of the campaign added.

    Raises InputError for a file, for a folder that is not a campaign's, and for a campaign by another version, with
    other shared fields or changed scenes. The axes may have other values: scenes, presets, parts, seeds can be added.
    """
    allowed, fields = "a new or empty folder, or that of this campaign", dict(campaign.fields)
    made = Saved(fields=fields, scenes=campaign.digests(), versions={"sixthsense": __version__})
    if not folder.exists() or (folder.is_dir() and all(entry.name == LOCK for entry in folder.iterdir())):
        return made
    if not (folder / FILE).is_file():
        kind = "the folder of a run" if (folder / "config.toml").is_file() else "not a campaign folder"
        raise InputError("out", f"{folder} is {kind if folder.is_dir() else 'a file'}", allowed)
    saved = read_folder(folder)
    both = saved.scenes.keys() & made.scenes.keys()
    before, now = (
        {**one.versions, **flat(one.fields), **{name: one.scenes[name] for name in both}} for one in (saved, made)
    )
    for name in dict.fromkeys([*before, *now]):
        if before.get(name) != now.get(name):
            old, new = (shown(one[name]) if name in one else "the preset's" for one in (before, now))
            raise InputError("out", f"{folder} is a campaign with {name} = {old}, found {new}", allowed)
    return saved.replaced(scenes={**saved.scenes, **made.scenes})


def save_folder(folder: Path, saved: Saved) -> None:
    """Write `campaign.toml`, if it has changed, as a whole or not at all; raises OSError that names the file."""
    import tomli_w

    if (folder / FILE).is_file() and read_folder(folder) == saved:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with whole(folder / FILE) as file:
        file.write_bytes(tomli_w.dumps(saved.model_dump()).encode())


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
        names = dict.fromkeys([*LABELS, *TEXTS, "run_time_s", *(name for row in rows for name in row)])
        frame = pd.DataFrame(rows, columns=list(names))
        return frame.sort_values([*AXES, "seed"], ignore_index=True)

    def curves(self) -> dict[str, pd.DataFrame]:
        """The errors along each run, by hash; none for a run that failed. InputError for a damaged file."""
        import pandas as pd

        found = {}
        for file in sorted(self._curves.glob("run-*.npz")):
            with readable(file), np.load(file) as columns:
                values = {name: columns[name].astype(np.float64) for name in COLUMNS}
                found[file.stem.removeprefix("run-")] = pd.DataFrame(values)
        return found
