"""`sixthsense campaign`."""

from __future__ import annotations

import sys
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from sixthsense.cli import DONE, FAILED, INTERRUPTED
from sixthsense.cli.common import announce
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config import load_config, preset
from sixthsense.config import parts as part_kinds
from sixthsense.config.errors import InputError
from sixthsense.config.files import NOTES, read_table
from sixthsense.config.tree import task_of


class Campaign(Options):
    """Monte Carlo: run every scene with every preset, estimator, other part and seed, and keep metrics of each run.

    The same command resumes a campaign that was stopped. With more scenes, seeds, ... it makes the missing runs only.

    Every field of the configuration is also an option, with one value for all runs: --task tour, --max-time 400,
    --laser.beams 181, ...; `sixthsense run --help` lists them.

    Exit code: 0 when all rows are complete, 1 when some have the outcome "error", 130 after Ctrl-C, 2 for bad input.
    """

    takes_fields: ClassVar[bool] = True

    scene: Annotated[tuple[str, ...], Arg("[SCENE ...]", is_positional=True)] = ()
    """Shipped names or files (.toml or map_server .yaml), before all options."""
    seeds: Annotated[tuple[str, ...], Arg("FIRST:LAST ...")] = ()
    """Seeds from FIRST to LAST, LAST excluded; several ranges and single seeds may be given."""
    preset: Annotated[tuple[str, ...], Arg("NAME ...")] = ()
    """Presets to compare."""
    estimator: Annotated[tuple[Annotated[str, part_kinds.ESTIMATORS], ...], Arg("NAME ...")] = ()
    """Estimators to compare."""
    front_end: Annotated[tuple[Annotated[str, part_kinds.FRONT_ENDS], ...], Arg("NAME ...")] = ()
    """Front ends to compare."""
    extractor: Annotated[tuple[Annotated[str, part_kinds.EXTRACTORS], ...], Arg("NAME ...")] = ()
    """Extractors of features to compare."""
    place_search: Annotated[tuple[Annotated[str, part_kinds.PLACE_SEARCHES], ...], Arg("NAME ...")] = ()
    """Place searches to compare."""
    planner: Annotated[tuple[Annotated[str, part_kinds.PLANNERS], ...], Arg("NAME ...")] = ()
    """Path planners to compare."""
    explorer: Annotated[tuple[Annotated[str, part_kinds.EXPLORERS], ...], Arg("NAME ...")] = ()
    """Explorers to compare."""
    config: Path | None = None
    """TOML file, partial or complete, that overrides each preset."""
    out: Annotated[Path | None, Arg("DIR")] = None
    """Folder to write: campaign.toml, rows.jsonl and curves/; ss.load_campaign(DIR) reads it."""
    retry_failed: bool = False
    """Repeat the runs with the outcome "error"; without it they count as done."""
    parts: Annotated[Path | None, Arg("DIR")] = None
    """Folder to search for parts of your own, also for those that only a file names. A part is code that is run."""
    workers: Annotated[int | None, Field(ge=1, le=1024)] = None
    """Processes of this machine; by default one per processor."""

    def run(self, flags: Table) -> int:
        """Make the runs of a campaign that are missing in its folder."""
        out = _checked_folder(self, flags)
        from sixthsense.campaigns import complete
        from sixthsense.campaigns.plan import AXES, campaign_of, plan, seed_range

        file = _read_config_table(self.config, self.preset)
        if self.parts is not None:
            part_kinds.import_named(file, self.parts)
        axes = {axis: (file[axis],) for axis in AXES if axis in file}
        axes |= {axis: values for axis in AXES if (values := getattr(self, axis))}
        seeds = (seed for text in self.seeds for seed in seed_range(text))
        campaign = campaign_of(axes, seeds, file, task_of(flags), flags)
        runs = plan(campaign)
        interrupted = False
        try:
            complete(campaign, runs, out, self.workers, retry_failed=self.retry_failed, say=announce)
        except KeyboardInterrupt:
            interrupted = True
        return _finish(out, runs, interrupted)


def _finish(out: Path, requested: Collection[str], interrupted: bool) -> int:
    from sixthsense.campaigns import CampaignRows, load_campaign
    from sixthsense.campaigns.worker import FAILED as FAILED_RUN

    rows = CampaignRows(out).rows.read()
    if rows:
        print(load_campaign(out).summary().to_string())
    finished = [rows[key] for key in requested if key in rows]
    failed = [row for row in finished if row["outcome"] == FAILED_RUN]
    if failed:
        where = " ".join(str(failed[0][name]) for name in ("scene", "estimator", "preset", "planner"))
        print(f"{len(failed)} runs failed, first {where} seed {failed[0]['seed']}: {failed[0]['error']}")
    if interrupted:
        done = f"{len(finished)} of {len(requested)} runs are in {out}/"
        print(f"sixthsense: interrupted, {done}, the same command makes the missing ones", file=sys.stderr)
        return INTERRUPTED
    print(f"written to {out}/: {len(rows)} runs")
    return FAILED if failed else DONE


def _checked_folder(options: Campaign, table: Table) -> Path:
    """The folder to write; InputError for missing options and for options that exclude each other."""
    if "seed" in table:
        raise InputError("seed", "found for a campaign", "`seeds` FIRST:LAST")
    if not options.seeds:
        raise InputError("seeds", "found nothing", "FIRST:LAST, such as 0:100")
    if options.out is None:
        raise InputError("out", "found nothing", "a folder to write")
    return options.out


def _read_config_table(path: Path | None, presets: tuple[str, ...]) -> dict[str, Any]:
    """Validate a configuration file and return its table; {} without a file."""
    if path is None:
        return {}
    for base in (*map(preset, presets), None):
        load_config(path, base)
    table = read_table(path)
    if "replayed" in table:
        raise InputError("config", f"{path} is of a replay", "the configuration of a simulated run")
    if presets and "preset" in table:
        raise InputError("preset", f"found with {path}, which names a preset", "one of the two")
    return {name: value for name, value in table.items() if name not in NOTES}
