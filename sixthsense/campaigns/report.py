"""The report on a campaign: figures of its groups, the table of its runs, and an HTML page."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.campaigns.call import Campaign
from sixthsense.campaigns.folder import read_folder
from sixthsense.campaigns.plan import AXES
from sixthsense.config.errors import InputError
from sixthsense.evaluation.groups import MOST_GROUPS, Group, Sample, differing, grouped, labelled
from sixthsense.evaluation.results import QUANTITIES
from sixthsense.evaluation.tables import digits
from sixthsense.figures.panels import group_figure
from sixthsense.figures.plot import Form, save_forms
from sixthsense.figures.report import contents, document, escaped, figure_block, flat_texts, metrics_rows, table

_FIGURES = {
    "error": "Errors of position and heading over time: median of the runs of a group, and the band of 10 to 90 %.",
    "error-distance": "The same over the distance travelled.",
    "rpe": "Relative pose error, that of the motion over pieces of path of a length: median of the runs, 10 to 90 %.",
    "nees": "NEES of the pose averaged over the runs, 3 if consistent, and the 95 % band of such an average.",
}
"""by name, also of the file: the caption"""


def report_campaign(folder: str | Path, out: str | Path, form: Form = "png") -> list[Path]:
    """Write figures, `metrics.csv` and `report.html` on a running or finished campaign into the folder `out`.

    Runs are grouped by the axes that differ, scene by scene. `form` "svg" or "pdf" adds each figure as vector graphics.
    A figure whose data all runs lack is left out. Returns the written files. Raises InputError for a folder that is
    not a campaign's, and for one without runs.
    """
    campaign, out = Campaign(folder), Path(out)
    samples = campaign.samples(campaign.name)
    if not samples:
        raise InputError(folder, "found no runs", "a campaign with at least one")
    out.mkdir(parents=True, exist_ok=True)
    pictures: dict[Path, str] = {}
    files: list[Path] = []
    tables: dict[str, str] = {}
    by_scene = _by_scene(samples)
    for scene, of_scene in by_scene.items():
        by = _axes(of_scene)
        suffix, heading = (f"-{scene}", f"Metrics in {scene}") if len(by_scene) > 1 else ("", "Metrics")
        for file, vectors, name in _draw(of_scene, by, out, suffix, form):
            pictures[file] = f"{scene}: {_FIGURES[name]}" if suffix else _FIGURES[name]
            files += vectors
        tables[heading] = _metrics(grouped(of_scene, by))
    files.append(out / "metrics.csv")
    campaign.frame().to_csv(files[-1], index=False)
    files.append(out / "report.html")
    files[-1].write_text(_page(campaign, pictures, tables), encoding="utf-8")
    return [*pictures, *files]


def _by_scene(samples: Sequence[Sample]) -> dict[str, list[Sample]]:
    """The runs by the names of their scenes."""
    found: dict[str, list[Sample]] = {}
    for sample in samples:
        found.setdefault(labelled("scene", sample.config.scene), []).append(sample)
    return found


def _axes(samples: Sequence[Sample]) -> list[str]:
    """The axes that differ in these runs, without the last ones where all would make too many groups."""
    fields = [sample.fields for sample in samples]
    by = differing(fields, AXES[1:]) or ["estimator"]
    while len(by) > 1 and len({tuple(one[name] for name in by) for one in fields}) > MOST_GROUPS:
        by.pop()
    return by


def _draw(
    samples: Sequence[Sample], by: Sequence[str], out: Path, suffix: str, form: Form
) -> Iterator[tuple[Path, list[Path], str]]:
    """Write the figures; yields for each the PNG, the file of vector graphics if any, and its name."""
    for name in _FIGURES:
        what, _, over = name.partition("-")
        try:
            picture = group_figure(what, samples, by, "distance" if over else "time", None)
        except InputError:
            continue
        file = out / f"{name}{suffix}.png"
        yield file, save_forms(picture, file, form), name


def _metrics(groups: Sequence[Group]) -> str:
    """The median of each metric over the runs of a group, and 10 to 90 %."""
    cells = [{key: _spread(group.metric(key)) for key in QUANTITIES if len(group.metric(key))} for group in groups]
    head = ["median (10 to 90 %)", *(f"{group.name}, {len(group.samples)} runs" for group in groups), "unit", "meaning"]
    return table(head, metrics_rows(cells), len(groups))


def _spread(values: Any) -> str:
    low, middle, high = (digits(float(value)) for value in np.percentile(values, [10.0, 50.0, 90.0]))
    return middle if low == high else f"{middle} ({low} to {high})"


def _page(campaign: Campaign, pictures: Mapping[Path, str], tables: Mapping[str, str]) -> str:
    saved = read_folder(campaign.folder)
    head, *rows = campaign.summary()
    title = f"Campaign {campaign.name}: {len(campaign)} runs"
    sections = {
        "Summary": table(head, rows),
        "Figures": "\n".join(figure_block(file, caption, title) for file, caption in pictures.items()),
        **tables,
        "Configuration": table(["field", "value"], list(map(list, _settings(saved)))),
        "Reproduction": f"<pre>{escaped(_command(campaign, saved))}</pre>",
    }
    sections = {name: content for name, content in sections.items() if content}
    return document(title, [contents(list(pictures), list(sections))], sections)


def _settings(saved: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The axes, the fields that all runs share, and the versions."""
    for axis, values in saved["axes"].items():
        yield axis, " ".join(values)
    yield from flat_texts(saved["fields"]).items()
    for name, version in saved.get("versions", {}).items():
        yield f"version of {name}", str(version)


def _command(campaign: Campaign, saved: Mapping[str, Any]) -> str:
    """The command that makes the campaign, or goes on with it."""
    axes = saved["axes"]
    words = ["sixthsense", "campaign", *axes["scene"], "--seeds", *axes["seeds"]]
    for axis in AXES[1:]:
        words += [f"--{axis.replace('_', '-')}", *axes[axis]] if axis in axes else []
    for name, value in flat_texts(saved["fields"]).items():
        section, dot, field = name.replace("_", "-").rpartition(".")
        words += [f"--{section}{dot}{'no-' * (value == 'false')}{field}"]
        words += [] if value in ("true", "false") else value.split()
    return shlex.join([*words, "--out", str(campaign.folder)])
