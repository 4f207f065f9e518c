"""`Campaign`, what `ss.campaign` and `ss.load_campaign` return: the table of a campaign's runs."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.campaigns.folder import read_folder
from sixthsense.campaigns.plan import AXES, import_extra
from sixthsense.campaigns.rows import Rows
from sixthsense.config import Config, merge, preset
from sixthsense.evaluation.groups import LABELS, Sample, Sampled
from sixthsense.evaluation.summary import summary
from sixthsense.evaluation.tables import html_table, text_table

if TYPE_CHECKING:
    import pandas as pd


class Campaign(Sampled):
    """The runs of a running or finished campaign, read from its folder whenever they are asked for.

    `frame()` is their table; `ss.compare(campaign)` draws figures of them. It prints as a table of means.
    """

    def __init__(self, folder: str | Path) -> None:
        """Open a folder; raises CampaignError for one that is not a campaign's, and without pandas or pyarrow."""
        self.folder = Path(folder)
        """with campaign.toml, rows/ and curves/"""
        self.name = self.folder.absolute().name
        self._fields = read_folder(self.folder)["fields"]
        import_extra("pandas")
        self._rows = Rows(self.folder)
        self._settings: dict[tuple[str, ...], Config] = {}

    def frame(self) -> pd.DataFrame:
        """A row per run, sorted: scene, estimator, front_end, preset, planner, seed, and a column per metric.

        A metric that a run lacks is NaN. A run that raised has the outcome "error" and the reason in the column
        `error`. Raises CampaignError for a table that cannot be read.
        """
        frame = self._rows.frame()
        # Earlier versions had no such column.
        frame["front_end"] = [self._setting(axes).front_end for axes in frame[list(AXES)].itertuples(index=False)]
        return frame[[*LABELS, *(name for name in frame.columns if name not in LABELS)]]

    def samples(self, name: str) -> list[Sample]:
        """The runs for a comparison, with their errors along their ways."""
        frame, curves = self.frame(), self._rows.curves()
        found = []
        for row in frame.to_dict("records"):
            config = merge(self._setting(tuple(row[axis] for axis in AXES)), {"seed": row["seed"]})
            metrics = {key: value for key, value in row.items() if key not in LABELS and value == value}
            found.append(Sample(name, config, partial(dict, metrics), partial(curves.get, row["config_hash"])))
        return found

    def summary(self) -> list[list[str]]:
        """A heading, and a row per scene, estimator, preset and planner with means and outcomes; empty without runs."""
        frame, curves = self.frame(), self._rows.curves()
        found = [curves.get(key) for key in frame["config_hash"]] if len(frame) else []
        return summary(frame, AXES, [None if one is None else one.nees for one in found]) if found else []

    def _setting(self, axes: tuple[str, ...]) -> Config:
        """The configuration of the runs with these values of `AXES`, with seed 0."""
        if axes not in self._settings:
            values = dict(zip(AXES, axes, strict=True))
            base = merge(preset(values.pop("preset")), self._fields)
            self._settings[axes] = merge(base, values)
        return self._settings[axes]

    def __len__(self) -> int:
        return len(self._rows.summaries())

    def __repr__(self) -> str:
        return "\n".join([f"<Campaign {self.name}: {len(self)} runs>", text_table(self.summary())])

    def _repr_html_(self) -> str:
        head, *rows = self.summary() or [["no run yet"]]
        return html_table(head, rows)

    def __getitem__(self, columns: Any) -> Any:
        """Columns of the frame, deprecated and kept for one version."""
        return self._of_frame(columns)[columns]

    def __getattr__(self, name: str) -> Any:
        """Attributes of the frame, deprecated and kept for one version."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._of_frame(name), name)

    def _of_frame(self, name: Any) -> pd.DataFrame:
        frame = self.frame()
        text = f"a campaign is no frame any more: use campaign.frame() for {name!r}"
        warnings.warn(text, DeprecationWarning, stacklevel=3)
        return frame


def load_campaign(folder: Path | str) -> Campaign:
    """Open a running or finished campaign: `.frame()` has a row per run, `ss.compare` draws figures.

        ss.load_campaign("mc").frame().groupby("estimator")["ate_rmse_m"].median()

    Raises CampaignError for a folder that is not a campaign's, and if pandas or pyarrow is missing.
    """
    return Campaign(folder)
