"""`sixthsense campaign`."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

from sixthsense.cli.common import announce, wants_help
from sixthsense.cli.exits import DONE, FAILED, INTERRUPTED
from sixthsense.cli.options import Table, UsageError, parse
from sixthsense.config import is_of_replay, load_config, preset, prior_map_of
from sixthsense.config.section import shown

USAGE = """\
usage: sixthsense campaign [SCENE ...] --seeds FIRST:LAST ... --out DIR [options]

Monte Carlo: run every scene with every estimator, preset, planner and seed, and keep a row of metrics for each run.

The same command resumes a campaign that was stopped. With more scenes, seeds, ... it makes the missing runs only.

  SCENE ...             shipped names or files (.toml, map_server .yaml, .scn), before all options
  --seeds FIRST:LAST    seeds from FIRST to LAST, LAST excluded; several ranges and single seeds may be given
  --estimator NAME ...  estimators to compare
  --preset NAME ...     presets
  --planner NAME ...    path planners
  --config FILE         TOML file, partial or complete, that overrides each preset
  --out DIR             folder to write: campaign.toml, and rows/ and curves/, Parquet folders; ss.load_campaign(DIR)
                        reads it
  --retry-failed        repeat the runs with the outcome "error"; without it they count as done
  --workers N           processes of the local cluster; by default one per processor
  --scheduler ADDRESS   run on the workers of a `dask scheduler` instead, such as tcp://127.0.0.1:8786

Every field of the configuration is also an option, with one value for all runs: --task tour, --max-time 400,
--laser.beams 181, ...; `sixthsense run --help` lists them.

Exit code: 0 when all rows are complete, 1 when some have the outcome "error", 130 after Ctrl-C, 2 for bad input.
"""

OWN = {"config": Path, "out": Path, "retry_failed": bool, "workers": int, "scheduler": str}
LISTS = ("scene", "estimator", "preset", "planner", "seeds")


def command(args: list[str]) -> int:
    """Make the runs of a campaign that are missing in its folder."""
    if wants_help(args):
        print(USAGE, end="")
        return DONE
    lists, rest = split_lists(args)
    given, table = parse(rest, OWN, "scene")
    _check(given, table, lists)
    from sixthsense.campaigns import CampaignPlan, Execution, complete
    from sixthsense.campaigns.plan import AXES, plan, resolve_scenes, seed_range, shared_fields

    file = _read_config_table(given.get("config"), lists.get("preset", []))
    default = preset()
    values = {axis: tuple(dict.fromkeys(lists.get(axis) or [file.get(axis, getattr(default, axis))])) for axis in AXES}
    task = {"task": "goal"} if table.get("goal") is not None else {}
    campaign = CampaignPlan(
        scenes=resolve_scenes(values["scene"]),
        estimators=values["estimator"],
        presets=values["preset"],
        planners=values["planner"],
        seeds=tuple(dict.fromkeys(seed for text in lists["seeds"] for seed in seed_range(text))),
        fields=shared_fields(file, task, table),
    )
    runs = plan(campaign)
    execution = Execution(given.get("workers"), given.get("scheduler"), given.get("retry_failed", False), say=announce)
    interrupted = False
    try:
        complete(campaign, runs, given["out"], execution)
    except KeyboardInterrupt:
        interrupted = True
    return _finish(given["out"], set(runs), interrupted)


def _finish(out: Path, requested: set[str], interrupted: bool) -> int:
    from sixthsense.campaigns import Rows
    from sixthsense.campaigns.result import Campaign
    from sixthsense.campaigns.worker import FAILED as FAILED_RUN
    from sixthsense.evaluation.tables import text_table

    frame = Rows(out).frame()
    if len(frame):
        print(text_table(Campaign(out).summary()))
    finished = frame[frame["config_hash"].isin(requested)]
    failed = finished[finished["outcome"] == FAILED_RUN]
    if len(failed):
        first = failed.iloc[0]
        where = f"{first.scene} {first.estimator} {first.preset} {first.planner} seed {first.seed}"
        print(f"{len(failed)} runs failed, first {where}: {first.error}")
    if interrupted:
        print(
            f"sixthsense: interrupted, {len(finished)} of {len(requested)} runs are in {out}/, "
            "the same command makes the missing ones",
            file=sys.stderr,
        )
        return INTERRUPTED
    print(f"written to {out}/: {len(frame)} runs")
    return FAILED if len(failed) else DONE


def split_lists(args: list[str]) -> tuple[dict[str, list[str]], list[str]]:
    """Separate the options with any number of values, and the scenes before all options, from the other arguments."""
    lists: dict[str, list[str]] = {}
    rest: list[str] = []
    words = list(reversed(args))  # a stack: the next word is the last element

    def store(name: str, values: list[str]) -> None:
        if not values:
            raise UsageError(f"--{name}: found nothing, allowed: one or more values")
        if name in lists:
            raise UsageError(f"--{name}: found twice, allowed: once, with all its values")
        lists[name] = values

    def take_values() -> list[str]:
        values = []
        while words and not words[-1].startswith("-"):
            values.append(words.pop())
        return values

    if scenes := take_values():
        store("scene", scenes)
    while words:
        word = words.pop()
        name, equals, text = word.removeprefix("--").partition("=")
        if word.startswith("--") and name in LISTS:
            store(name, [text] if equals else take_values())
        else:
            rest.append(word)
    return lists, rest


def _check(given: Table, table: Table, lists: dict[str, list[str]]) -> None:
    """Raise UsageError for missing options and for options that exclude each other."""
    if "scene" in given:
        raise UsageError(f"scene: found {shown(given['scene'])} after an option, allowed: before all options")
    if "seed" in table:
        raise UsageError("--seed: found for a campaign, allowed: --seeds FIRST:LAST")
    if "seeds" not in lists:
        raise UsageError("--seeds: found nothing, allowed: FIRST:LAST, such as 0:100")
    if "out" not in given:
        raise UsageError("--out: found nothing, allowed: a folder to write")
    workers = given.get("workers")
    if workers is not None and not (isinstance(workers, int) and 1 <= workers <= 1024):
        raise UsageError(f"--workers: found {shown(workers)}, allowed: a whole number from 1 to 1024")
    if workers is not None and "scheduler" in given:
        raise UsageError("--workers: found with --scheduler, which has its own workers, allowed: one of the two")
    if table.get("goal") is not None and table.get("task", "goal") != "goal":
        raise UsageError(f"--goal: found with --task {table['task']}, allowed: with --task goal")


def _read_config_table(path: Path | None, presets: list[str]) -> dict[str, Any]:
    """Validate a configuration file and return its table; {} without a file."""
    if path is None:
        return {}
    for name in presets:
        load_config(path, preset(name))
    load_config(path)
    if is_of_replay(path):
        raise UsageError(f"--config: {path} is of a replay, allowed: the configuration of a simulated run")
    if prior_map_of(path) is not None:
        raise UsageError(f"--config: {path} is of a run with a prior map, allowed: the configuration of a run without")
    from sixthsense.config.files import NOTES

    table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    if presets and "preset" in table:
        raise UsageError(f"--preset: found with {path}, which names a preset, allowed: one of the two")
    return {name: value for name, value in table.items() if name not in NOTES}
