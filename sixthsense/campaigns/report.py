"""The report on a campaign: figures of its groups, the table of its runs, and an HTML page."""

from __future__ import annotations

import shlex
from pathlib import Path

from sixthsense.campaigns.call import Campaign
from sixthsense.campaigns.folder import Saved, read_folder
from sixthsense.campaigns.plan import AXES
from sixthsense.config.errors import InputError
from sixthsense.figures.plot import Form
from sixthsense.figures.report import Text, flat_texts, report_groups


def report_campaign(folder: str | Path, out: str | Path, form: Form = "png") -> list[Path]:
    """Write figures, `metrics.csv` and `report.html` on a running or finished campaign into the folder `out`.

    Runs are grouped by the axes that differ, scene by scene. `form` "svg" or "pdf" adds each figure as vector graphics.
    A figure whose data all runs lack is left out. Returns the written files. Raises InputError for a folder that is
    not a campaign's, and for one without runs.
    """
    import pandas as pd

    campaign, out = Campaign(folder), Path(out)
    samples = campaign.samples(campaign.name)
    if not samples:
        raise InputError(folder, "found no runs", "a campaign with at least one")
    saved = read_folder(campaign.folder)
    settings = {axis: " ".join(values) for axis, values in saved.axes.items()} | flat_texts(saved.fields)
    settings |= {f"version of {name}": str(version) for name, version in saved.versions.items()}
    sections = {
        "Summary": [campaign.summary()],
        "Configuration": [pd.Series(settings, name="value").to_frame()],
        "Reproduction": [Text(_command(campaign, saved))],
    }
    title = f"Campaign {campaign.name}: {len(campaign)} runs"
    files = report_groups(title, samples, AXES[1:], out, form, sections)
    campaign.frame().to_csv(out / "metrics.csv", index=False)
    return [*files, out / "metrics.csv"]


def _command(campaign: Campaign, saved: Saved) -> str:
    """The command that makes the campaign, or goes on with it."""
    axes = saved.axes
    words = ["sixthsense", "campaign", *axes["scene"], "--seeds", *axes["seeds"]]
    for axis in AXES[1:]:
        words += [f"--{axis.replace('_', '-')}", *axes[axis]] if axis in axes else []
    for name, value in flat_texts(saved.fields).items():
        section, dot, field = name.replace("_", "-").rpartition(".")
        words += [f"--{section}{dot}{'no-' * (value == 'false')}{field}"]
        words += [] if value in ("true", "false") else value.split()
    return shlex.join([*words, "--out", str(campaign.folder)])
