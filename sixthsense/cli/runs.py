"""Commands that make runs: `sixthsense run`, `replay`, `merge`, `calibrate` and `campaign`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from sixthsense.cli import DONE, FAILED, INTERRUPTED
from sixthsense.cli.common import Common, OfScene, WithPriorMap
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config import Config, load_config, notes_of
from sixthsense.config.errors import InputError
from sixthsense.config.files import NOTES, read_table
from sixthsense.config.parts import KINDS, OF_THE_ROBOT, import_named
from sixthsense.config.tree import task_of


class Run(WithPriorMap, OfScene):
    """Simulate a robot in a scene unknown to it: it explores the scene, or drives to goals."""

    realtime: bool = False
    """Slow the simulation down to real time."""

    def run(self, flags: Table) -> int:
        """Simulate a scene."""
        if self.config is not None and "replayed" in notes_of(self.config):
            raise InputError("config", f"{self.config} is of a replay", "sixthsense replay LOG `config` FILE")
        from sixthsense import api
        from sixthsense.running.progress import paced

        stem = f"{Path(self.settings.scene).stem}-{self.settings.estimator}"
        return self.started(api.run, stem, self.settings, hook=paced() if self.realtime else None, **self.prior())


class Replay(WithPriorMap):
    """Process a recorded log.

    CARMEN (.log, .clf) or a graph of landmarks (.graph, .g2o), plain or .gz, .bz2, .xz; a ROS 1 or ROS 2
    bag; the folder of a run; an MRCLAM folder.
    """

    base: ClassVar[str] = "log"
    refused: ClassVar[tuple[str, ...]] = OF_THE_ROBOT

    log: Annotated[str | None, Arg("LOG", is_positional=True)] = None
    """The log."""
    relations: Annotated[Path | None, Arg("FILE")] = None
    """Hand-checked relations between poses, to measure errors. They are those of Kuemmerle et al. 2009."""
    topics: Annotated[str | None, Arg("NAME[,NAME]")] = None
    """Topics to use from a bag with several topics of scans or odometry."""
    odometry_frames: Annotated[str | None, Arg("P,C")] = None
    """Frames of odometry in /tf, such as odom,base_link. Without a topic of odometry they are found."""
    robot: Annotated[int | None, Arg("N")] = None
    """Robot to use from an MRCLAM folder with several."""

    @classmethod
    def start(cls, given: Table) -> str | Config:
        """The preset of the log's kind, or the configuration of a recorded run."""
        from sixthsense.logs.replay_input import base_of

        return base_of(given.get("log"))

    def run(self, flags: Table) -> int:
        """Replay a log."""
        from sixthsense import api
        from sixthsense.logs.replay_input import check_options

        check_options(self.log, flags)
        stem = f"{Path(self.log or '').absolute().name.split('.')[0]}-{self.settings.estimator}"
        given = {"topics": self.topics, "odometry_frames": self.odometry_frames}
        chosen = {name: tuple(words.split(",")) if words else () for name, words in given.items()} | self.prior()
        return self.started(api.replay, stem, self.log, self.settings, self.relations, robot=self.robot, **chosen)


class Merge(Common):
    """Map two runs in one building together: scans of both are aligned, in the frame of the first.

    The second run is found in the map of the first by what it has seen. The result is the folder of a run.
    """

    base: ClassVar[str] = "log"
    refused: ClassVar[tuple[str, ...]] = OF_THE_ROBOT

    runs: Annotated[tuple[str, ...], Arg("RUN_A RUN_B", is_positional=True)] = ()
    """The folders of the two runs."""

    @classmethod
    def start(cls, given: Table) -> str | Config:
        """The configuration of the first run; InputError for other than two."""
        from sixthsense.logs.replay_input import base_of

        runs = given.get("runs", ())
        if len(runs) != 2:
            raise InputError("runs", f"found {' '.join(runs) or 'nothing'}", "the folders of two runs")
        return base_of(runs[0])

    def run(self, flags: Table) -> int:
        """Merge two runs."""
        from sixthsense import api
        from sixthsense.logs.replay_input import check_options

        check_options(self.runs[0], flags)
        names = (Path(run).absolute().name for run in self.runs)
        return self.started(api.merge_runs, "-".join(names), *self.runs, config=self.settings)


class Calibrate(OfScene):
    """Measure the robot's noise against the truth, and write it as a configuration for `run --config`."""

    out: Annotated[Path | None, Arg("FILE")] = None
    """TOML file to write, a partial configuration; its figure is written beside it as .png."""
    overwrite: bool = False
    """Replace the file and its figure if they exist."""
    samples: int = 100
    """Samples of motion, one every half second."""

    def run(self, flags: Table) -> int:
        """Measure the robot's noise."""
        if self.out is None:
            raise InputError("out", "found nothing", "a file to write, such as noise.toml")
        from tqdm import tqdm

        from sixthsense.evaluation.calibrate import calibrate, check_output, summary
        from sixthsense.figures.calibration import write_calibration
        from sixthsense.running.warmup import prepare
        from sixthsense.simulation.scene_files import scene_file

        config, scene = self.settings, scene_file(self.settings.scene)
        check_output(self.out, self.overwrite)
        prepare()
        with tqdm(total=self.samples, desc="calibrate", unit=" samples", disable=None, leave=False) as bar:
            found = calibrate(config, self.samples, bar.update)
        title = f"calibration · {scene.stem} · {config.preset} · seed {config.seed}"
        write_calibration(found, config, self.out, title)
        print("\n".join(summary(found)))
        print(f"written to {self.out} and {self.out.with_suffix('.png')}")
        return DONE


class Campaign(Options):
    """Monte Carlo: run every scene with every preset, estimator, other part and seed, and keep metrics of each run.

    The same command resumes a campaign that was stopped. With more scenes, seeds, ... it makes the missing runs only.

    Every field of the configuration is also an option, with one value for all runs: --task tour, --max-time 400,
    --laser.beams 181, ...; `sixthsense run --help` lists them. The preset and the parts may have
    several values, which are compared: --preset default worn, --estimator ekf isam2.

    Exit code: 0 when all rows are complete, 1 when some have the outcome "error", 130 after Ctrl-C, 2 for bad input.
    """

    takes_fields: ClassVar[bool] = True
    several: ClassVar[tuple[str, ...]] = ("preset", *(parts.kind for parts in KINDS))

    scene: Annotated[tuple[str, ...], Arg("[SCENE ...]", is_positional=True)] = ()
    """Shipped names or files (.toml or map_server .yaml), before all options."""
    seeds: Annotated[tuple[str, ...], Arg("FIRST:LAST ...")] = ()
    """Seeds from FIRST to LAST, LAST excluded; several ranges and single seeds may be given."""
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
        if "seed" in flags:
            raise InputError("seed", "found for a campaign", "`seeds` FIRST:LAST")
        if not self.seeds:
            raise InputError("seeds", "found nothing", "FIRST:LAST, such as 0:100")
        if self.out is None:
            raise InputError("out", "found nothing", "a folder to write")
        from sixthsense.campaigns.call import campaign, load_campaign
        from sixthsense.campaigns.folder import CampaignRows
        from sixthsense.campaigns.plan import AXES, seed_range, shared_fields
        from sixthsense.campaigns.plan import FAILED as FAILED_RUN

        file = _file_of_campaign(self.config, flags.get("preset", ()))
        if self.parts is not None:
            import_named(file, self.parts)
        given = {**flags, **({"scene": self.scene} if self.scene else {})}
        axes = {axis: table[axis] for table in (file, given) for axis in AXES if axis in table}
        fields, code = {**shared_fields(file, task_of(flags), flags), **axes}, DONE
        fields |= {"seeds": [seed for text in self.seeds for seed in seed_range(text)], "out": self.out}
        try:
            campaign(fields.pop("scene", "apartment"), workers=self.workers, retry_failed=self.retry_failed, **fields)
        except KeyboardInterrupt:
            code = INTERRUPTED
        rows = CampaignRows(self.out).frame()
        if len(rows):
            print(load_campaign(self.out).summary().to_string())
        failed = rows[rows["outcome"] == FAILED_RUN]
        for row in failed.to_dict("records")[:1]:
            where = " ".join(str(row[name]) for name in ("scene", "estimator", "preset", "planner"))
            print(f"{len(failed)} runs failed, first {where} seed {row['seed']}: {row['error']}")
            code = code or FAILED
        if code != INTERRUPTED:
            print(f"written to {self.out}/: {len(rows)} runs")
        return code


def _file_of_campaign(path: Path | None, presets: Sequence[str]) -> Table:
    """The table of a configuration file, which is validated; {} without a file."""
    if path is None:
        return {}
    load_config(path)
    table = read_table(path)
    if "replayed" in table:
        raise InputError("config", f"{path} is of a replay", "the configuration of a simulated run")
    if presets and "preset" in table:
        raise InputError("preset", f"found with {path}, which names a preset", "one of the two")
    return {name: value for name, value in table.items() if name not in NOTES}
