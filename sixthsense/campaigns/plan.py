"""The axes of a campaign, the fields that its runs share, the list of runs, and what a worker makes of each."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import platform
import re
import socket
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from sixthsense.config import Config, as_table, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.config.files import absolute
from sixthsense.config.parts import FILTERS, KINDS, options_class
from sixthsense.config.section import shown
from sixthsense.config.tree import with_checked_parts
from sixthsense.config.version import __version__
from sixthsense.record.stream import packed

ALWAYS = ("scene", "estimator", "preset", "planner")
"""axes that every campaign has a value of"""
AXES: tuple[str, ...] = (*ALWAYS, *(parts.kind for parts in KINDS if parts.kind not in ALWAYS))
"""fields of the configuration that a campaign may vary, besides the seed; what the others are follows from the preset
where they have no value"""

MOST_RUNS = 100_000
FAILED = "error"
"""the outcome of a run that raised"""
CURVES = "curves"
"""key of a row under which a worker returns the run's errors along its way"""

_SEEDS = re.compile(r"([0-9]{1,18})(?::([0-9]{1,18}))?")


@dataclass(frozen=True)
class CampaignPlan:
    """The values of the axes of a campaign, and the fields that its runs share."""

    values: Mapping[str, tuple[str, ...]]
    """of those of `AXES` that have some; scenes are shipped names or files"""
    seeds: tuple[int, ...]
    """without duplicates"""
    fields: Mapping[str, Any]
    """nested table in the form of a configuration file, without the axes"""

    def bases(self) -> list[Config]:
        """The configuration of each preset with the shared fields."""
        return [merge(preset(name), self.fields) for name in self.values["preset"]]

    def digests(self) -> dict[str, str]:
        """The hash of each scene's content, as `scene_digest`."""
        map_unknown = self.bases()[0].map_unknown
        return {scene: scene_digest(scene, map_unknown) for scene in self.values["scene"]}

    def settings(self) -> list[Config]:
        """The configuration of every combination of the axes but the seed, with seed 0.

        Raises InputError for a name or field that is not allowed, for a scene, start or goal, and for a part that no
        worker can import.
        """
        from sixthsense.simulation.mission import mission_of
        from sixthsense.simulation.scene import load_scene

        bases = self.bases()
        found = []
        for scene in self.values["scene"]:
            loaded = load_scene(scene, bases[0].map_unknown)
            for base in bases:
                at_scene, _ = mission_of(base.replaced(scene=scene), loaded)
                for names in itertools.product(*(self.values.get(parts.kind, (None,)) for parts in KINDS)):
                    named = {parts.kind: name for parts, name in zip(KINDS, names, strict=True) if name is not None}
                    found.append(with_parts(at_scene, self.fields, **named))
        return found


def with_parts(base: Config, fields: Mapping[str, Any], **names: str) -> Config:
    """The configuration with parts of these names and seed 0; a part that has options takes those of `fields`.

    Raises InputError for a part that cannot be imported, or whose options are others.
    """
    table: dict[str, Any] = {**names, "seed": 0}
    for parts in KINDS:
        options, name = f"{parts.kind}_options", names.get(parts.kind, getattr(base, parts.kind))
        if name.startswith("__main__:"):
            found = f"found {name}, which is of the program that is running"
            raise InputError(parts.kind, found, "a class or function of a module, which the workers import")
        if name not in parts.shipped:
            factory = parts.load(name)
            table[options] = fields.get(options, {}) if options_class(factory) else {}
    return with_checked_parts(merge(base, table))


def plan(campaign: CampaignPlan) -> dict[str, Config]:
    """The configurations of all runs of a campaign by their hashes, ordered by seed: settings progress equally.

    Raises InputError for too many runs, and the errors of `CampaignPlan.settings`.
    """
    count = math.prod(map(len, (*campaign.values.values(), campaign.seeds)))
    if count > MOST_RUNS:
        raise InputError("campaign", f"found {count} runs", f"at most {MOST_RUNS}")
    settings = campaign.settings()
    runs = (setting.model_copy(update={"seed": seed}) for seed in campaign.seeds for setting in settings)
    return {config_hash(run): run for run in runs}


def config_hash(config: Config) -> str:
    """Hash of a configuration: the first 16 hexadecimal digits of the SHA-256 of all its fields."""
    return _hash(as_table(config))


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def scene_digest(scene: str, map_unknown: Literal["wall", "free"] = "wall") -> str:
    """Hash of all of a scene's content but its name, 16 hexadecimal digits; raises InputError.

    `map_unknown` is what the unknown cells of a map_server map are.
    """
    from sixthsense.simulation.scene import load_scene

    return _hash(packed(replace(load_scene(scene, map_unknown), name="", notes=())))


def seed_range(text: str) -> range:
    """Parse `FIRST:LAST`, such as `0:100`, where LAST is excluded, or a single seed such as `7`.

    Raises InputError for an empty, reversed, too long or malformed range.
    """
    found = _SEEDS.fullmatch(text)
    first, last = (int(found[1]), int(found[2] or int(found[1]) + 1)) if found else (0, 0)
    if not 0 < last - first <= MOST_RUNS:
        allowed = f"one seed, or FIRST:LAST such as 0:100, without LAST, of at most {MOST_RUNS} seeds"
        raise InputError("seeds", f"found {shown(text)}", allowed)
    return range(first, last)


def shared_fields(*tables: Mapping[str, Any]) -> dict[str, Any]:
    """What nested tables state; later values override, None removes a field. Axes and seed are left out."""
    found = preset()
    for table in tables:
        found = merge(found, {name: value for name, value in table.items() if name not in (*AXES, "seed")})
    return found.model_dump(mode="json", exclude_unset=True, exclude_none=True, exclude={*AXES, "seed"})


def campaign_of(axes: Mapping[str, Iterable[str]], seeds: Iterable[int], *tables: Mapping[str, Any]) -> CampaignPlan:
    """The plan of a campaign from the values of its axes, and nested tables of fields, of which later ones override.

    Files of scenes are taken by their absolute paths, so that names do not depend on the working folder. The estimator
    of a campaign that names none is one that all its front ends can use.
    """
    by_front_end = [merge(preset(), {"front_end": name}) for name in axes.get("front_end", ())]
    usual = max(by_front_end or [preset()], key=lambda base: base.estimator not in FILTERS)
    scenes = (str(absolute(scene)) if Path(scene).suffix else scene for scene in axes["scene"])
    axes = {**{axis: (getattr(usual, axis),) for axis in ALWAYS}, **axes, "scene": scenes}
    values = {axis: tuple(dict.fromkeys(axes[axis])) for axis in AXES if axis in axes}
    return CampaignPlan(values, tuple(dict.fromkeys(seeds)), shared_fields(*tables))


def described(campaign: CampaignPlan) -> dict[str, str]:
    """With what this process would make the runs of a campaign: versions, and the hash of each scene.

    Raises InputError for a scene that it cannot read, and for a part that it cannot import.
    """
    campaign.settings()
    return {"sixthsense": __version__, "python": platform.python_version().rpartition(".")[0], **campaign.digests()}


def row_of(config: Config) -> dict[str, Any]:
    """The columns that are known before a run: the configuration's hash, the axes, the task and the seed."""
    return {"config_hash": config_hash(config), **{name: getattr(config, name) for name in (*AXES, "task", "seed")}}


def run_row(config: Config) -> dict[str, Any]:
    """Make one run and return its row; if the run raises, the row has the outcome `FAILED` and a one-line reason."""
    from sixthsense.running.warmup import prepare

    row = {**row_of(config), "host": socket.gethostname(), "version": __version__}
    began = time.perf_counter()
    try:
        prepare(config)  # keeps the compilation out of the run's time
        began = time.perf_counter()
        row |= _metrics(config)
    except Exception as error:
        row |= {"outcome": FAILED, "error": one_line(error)}
    return {**row, "run_time_s": time.perf_counter() - began}


def failed_row(config: Config, error: BaseException) -> dict[str, Any]:
    """The row of a run whose worker has failed."""
    return {**row_of(config), "version": __version__, "outcome": FAILED, "error": one_line(error)}


def one_line(error: BaseException) -> str:
    """An exception's type and message in one line of at most 500 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _metrics(config: Config) -> dict[str, Any]:
    """The metrics of a run, and its errors along its way."""
    from sixthsense.evaluation.curves import curves
    from sixthsense.running.runs import simulate
    from sixthsense.simulation.mission import mission_of

    run = simulate(*mission_of(config))
    return {**run.metrics, CURVES: curves(run.trace)}
