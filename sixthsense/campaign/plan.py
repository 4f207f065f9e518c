"""What a campaign varies, what all its runs share, and the list of runs that follows."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sixthsense.campaign.errors import CampaignError
from sixthsense.config import Config, as_table, merge, preset
from sixthsense.config.section import shown

AXES: tuple[str, ...] = ("scene", "estimator", "preset", "planner")
"""fields of the configuration that a campaign may vary beside the seed"""

MOST_RUNS = 100_000

_SEEDS = re.compile(r"([0-9]{1,18})(?::([0-9]{1,18}))?")


@dataclass(frozen=True)
class Campaign:
    """The axes of a campaign, each with at least one value, and the fields that its runs share."""

    scenes: tuple[str, ...]
    """shipped names, or files"""
    estimators: tuple[str, ...]
    """back ends"""
    presets: tuple[str, ...]
    """presets, over which the shared fields are laid"""
    planners: tuple[str, ...]
    """path planners"""
    seeds: tuple[int, ...]
    """each once"""
    fields: Mapping[str, Any]
    """nested table, as a configuration file holds it, with none of the axes"""

    def axes(self) -> dict[str, list[str]]:
        """The values of each axis as lists of texts; seeds as ranges."""
        values = (self.scenes, self.estimators, self.presets, self.planners)
        return {**{axis: list(v) for axis, v in zip(AXES, values, strict=True)}, "seeds": ranges(self.seeds)}

    def settings(self) -> list[Config]:
        """The configurations that differ in more than the seed, with seed 0.

        Raises ConfigError for a name or field that is not allowed, SceneError for a scene, start or goal.
        """
        from sixthsense.sources.mission import mission
        from sixthsense.sources.scene import load_scene

        bases = [merge(preset(name), self.fields, "--") for name in self.presets]
        found = []
        for scene in self.scenes:
            loaded = load_scene(scene)
            for base in bases:
                at_scene = dataclasses.replace(base, scene=scene)
                mission(loaded, at_scene)
                for planner, estimator in itertools.product(self.planners, self.estimators):
                    names = {"planner": planner, "estimator": estimator, "seed": 0}
                    found.append(merge(at_scene, names, "--"))
        return found


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run of a campaign."""

    setting: Config
    """but for the seed"""
    seed: int
    """of all randomness"""

    @property
    def config(self) -> Config:
        """The whole configuration."""
        return dataclasses.replace(self.setting, seed=self.seed)

    def axes(self) -> dict[str, Any]:
        """The values that the campaign varies."""
        return {**{axis: getattr(self.setting, axis) for axis in AXES}, "seed": self.seed}


def plan(campaign: Campaign) -> dict[str, PlannedRun]:
    """Every run of a campaign by the hash of its configuration, seed by seed, so that all settings grow alike.

    Raises CampaignError for too many runs, and what `Campaign.settings` raises.
    """
    axes = (campaign.scenes, campaign.estimators, campaign.presets, campaign.planners, campaign.seeds)
    count = 1
    for values in axes:
        count *= len(values)
    if count > MOST_RUNS:
        raise CampaignError(f"campaign: found {count} runs, allowed: at most {MOST_RUNS}")
    tables = [(setting, as_table(setting)) for setting in campaign.settings()]
    return {
        _hash({**table, "seed": seed}): PlannedRun(setting, seed)
        for seed in campaign.seeds
        for setting, table in tables
    }


def config_hash(config: Config) -> str:
    """16 hexadecimal digits that tell one configuration from another: the start of the SHA-256 of all its fields."""
    return _hash(as_table(config))


def _hash(table: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()[:16]


def scene_digest(scene: str) -> str:
    """16 hexadecimal digits of what a scene holds, whatever its file is called; raises SceneError."""
    from sixthsense.sources.scene import load_scene

    loaded = load_scene(scene)
    content = (loaded.walls.tolist(), loaded.start, loaded.radius, loaded.goal, loaded.tour, loaded.region)
    return hashlib.sha256(repr(content).encode()).hexdigest()[:16]


def seed_range(word: str) -> range:
    """The seeds that a word such as `0:100` (the last is not among them) or `7` means.

    Raises CampaignError for a range that is empty, reversed or malformed.
    """
    found = _SEEDS.fullmatch(word)
    allowed = "allowed: FIRST:LAST with LAST, which is not among them, above FIRST, such as 0:100, or one seed"
    if found is None:
        raise CampaignError(f"--seeds: found {shown(word)}, {allowed}")
    first = int(found[1])
    last = first + 1 if found[2] is None else int(found[2])
    if last <= first:
        raise CampaignError(f"--seeds: found {shown(word)}, {'empty' if last == first else 'reversed'}, {allowed}")
    if last - first > MOST_RUNS:
        raise CampaignError(f"--seeds: found {last - first} of them, allowed: at most {MOST_RUNS}")
    return range(first, last)


def ranges(seeds: Iterable[int]) -> list[str]:
    """The words, in ascending order, that `seed_range` reads back as the `seeds`."""
    words: list[str] = []
    for _, run in itertools.groupby(enumerate(sorted(set(seeds))), lambda place: place[1] - place[0]):
        values = [seed for _, seed in run]
        words.append(f"{values[0]}:{values[-1] + 1}")
    return words


def shared_fields(*tables: Mapping[str, Any]) -> dict[str, Any]:
    """One nested table of several, the later ones winning, without the axes, the seed, and fields that are absent."""
    fields: dict[str, Any] = {}

    def lay(over: dict[str, Any], table: Mapping[str, Any]) -> None:
        for key, value in table.items():
            name = key.replace("-", "_")
            if isinstance(value, Mapping):
                lay(over.setdefault(name, {}), value)
            elif value is None:
                over.pop(name, None)
            else:
                over[name] = list(value) if isinstance(value, tuple) else value

    for table in tables:
        lay(fields, {name: value for name, value in table.items() if name not in (*AXES, "seed")})
    return fields


def resolved(scenes: Sequence[str]) -> tuple[str, ...]:
    """Scenes by names that mean the same wherever one stands: files by their absolute path, each once."""
    return tuple(dict.fromkeys(str(Path(scene).resolve()) if Path(scene).suffix else scene for scene in scenes))
