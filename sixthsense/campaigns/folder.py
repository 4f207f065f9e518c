"""The folder of a campaign: `campaign.toml` with the axes and shared fields, and `rows/` with one row per run."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sixthsense.campaigns.plan import AXES, CampaignError, CampaignPlan, PlannedRun, ranges, scene_digest, seed_range
from sixthsense.config import as_table, merge, preset
from sixthsense.config.section import shown
from sixthsense.config.version import __version__
from sixthsense.record.writing import whole

FILE = "campaign.toml"


def check_folder(folder: Path, campaign: CampaignPlan) -> Mapping[str, Any] | None:
    """Check the output folder and return its `campaign.toml`, or None for a new or empty folder.

    Raises CampaignError for a file, for a folder that is not a campaign's, and for a campaign with other shared fields
    or changed scenes. The axes may have other values: scenes, estimators, presets, planners and seeds can be added.
    """
    allowed = "allowed: a new or empty folder, or that of this campaign"
    if folder.exists() and not folder.is_dir():
        raise CampaignError(f"--out: {folder} is a file, {allowed}")
    if not folder.exists() or not any(folder.iterdir()):
        return None
    if not (folder / FILE).is_file():
        kind = "the folder of a run" if (folder / "config.toml").is_file() else "not a campaign folder"
        raise CampaignError(f"--out: {folder} is {kind}, {allowed}")
    saved = read_folder(folder)
    before, now = dict(_flatten(saved["fields"])), dict(_flatten(_typed_fields(campaign)))
    for name in dict.fromkeys([*before, *now]):
        if before.get(name) != now.get(name):
            old, new = (shown(table[name]) if name in table else "the preset's" for table in (before, now))
            raise CampaignError(f"--out: {folder} is a campaign with {name} = {old}, found {new}, {allowed}")
    for scene in campaign.scenes:
        if saved["scenes"].get(scene, digest := scene_digest(scene)) != digest:
            raise CampaignError(f"--out: the scene {scene} has changed since {folder} was created, {allowed}")
    return saved


def check_rows(folder: Path, runs: Mapping[str, PlannedRun], rows: list[dict[str, Any]]) -> None:
    """Raise CampaignError if the folder has a row of a planned run with another configuration.

    A preset or a default value that differs between two versions of the package is the usual cause.
    """
    hashes = {tuple(run.axes().values()): key for key, run in runs.items()}
    for row in rows:
        values = tuple(row[name] for name in (*AXES, "seed"))
        if hashes.get(values, row["config_hash"]) != row["config_hash"]:
            raise CampaignError(
                f"--out: {folder} has the run {' '.join(map(str, values))} with another configuration, from version "
                f"{row['version']} of the package, allowed: another folder"
            )


def save_folder(folder: Path, campaign: CampaignPlan, saved: Mapping[str, Any] | None) -> None:
    """Write `campaign.toml` atomically, with the axes of `saved` extended by those of the campaign.

    Raises OSError that names the file.
    """
    import tomli_w

    axes = campaign.axes()
    scenes = {scene: scene_digest(scene) for scene in campaign.scenes}
    if saved is not None:
        seeds = [seed for text in saved["axes"]["seeds"] for seed in seed_range(text)]
        axes = {axis: list(dict.fromkeys([*saved["axes"][axis], *values])) for axis, values in axes.items()}
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
    """Read `campaign.toml` as a table; raises CampaignError for a missing or damaged file."""
    file = folder / FILE
    allowed = "allowed: the folder of a campaign"
    if not file.is_file():
        found = f"no {FILE} in it" if folder.is_dir() else "a file" if folder.exists() else "no such folder"
        raise CampaignError(f"{folder}: found {found}, {allowed}")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise CampaignError(f"{file}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise CampaignError(f"{file}: is not TOML ({error}), {allowed}") from None
    for name in ("axes", "fields", "scenes"):
        if not isinstance(table.get(name), dict):
            raise CampaignError(f"{file}: {name}: found no such table, {allowed}")
    for axis in (*AXES, "seeds"):
        values = table["axes"].get(axis)
        if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
            raise CampaignError(f"{file}: axes.{axis}: found {shown(values)}, allowed: a list of texts")
    try:
        for text in table["axes"]["seeds"]:
            seed_range(text)
    except CampaignError as error:
        raise CampaignError(f"{file}: axes.{str(error).removeprefix('--')}") from None
    return table


def _typed_fields(campaign: CampaignPlan) -> dict[str, Any]:
    """The shared fields with the types of the configuration: numbers of the field's type, lists for tuples."""

    def select(table: Mapping[str, Any], names: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: select(table[name], value) if isinstance(value, Mapping) else _plain(table[name])
            for name, value in sorted(names.items())
            if name in table
        }

    return select(as_table(merge(preset(campaign.presets[0]), campaign.fields, "--")), campaign.fields)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _flatten(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{path}{name}.")
        else:
            yield path + name, value
