"""`sixthsense run`, `replay` and `merge`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from sixthsense.cli.common import Common, OfScene, WithPriorMap, announce, live_view, run_folder, show_end
from sixthsense.cli.options import Arg, Table
from sixthsense.config import Config, is_of_replay
from sixthsense.config.errors import InputError
from sixthsense.config.parts import OF_THE_ROBOT


class Run(WithPriorMap, OfScene):
    """Simulate a robot in a scene unknown to it: it explores the scene, or drives to goals."""

    realtime: bool = False
    """Slow the simulation down to real time."""

    def run(self, flags: Table) -> int:
        """Simulate a scene."""
        if self.config is not None and is_of_replay(self.config):
            raise InputError("config", f"{self.config} is of a replay", "sixthsense replay LOG `config` FILE")
        config = self.settings_of_scene()
        from sixthsense.api import with_task
        from sixthsense.running.runs import RunHooks, simulate
        from sixthsense.simulation.mission import mission_of

        prior = self.prior_start()
        config, task = mission_of(with_task(config, flags))
        for note in task.scene.notes:
            announce(f"note: {task.scene.name}: {note}")
        with (
            run_folder(self, config, f"{task.scene.name}-{config.estimator}", prior=prior) as folder,
            live_view(self) as hooks,
        ):
            watch = RunHooks(hooks, realtime=self.realtime, say=announce)
            return show_end(simulate(config, task, folder, watch, prior), self)


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
        from sixthsense.logs.replay_input import LogSelection, check_options, check_out, open_recorded

        given = self.topics, self.odometry_frames
        topics, frames = (tuple(words.split(",")) if words else () for words in given)
        chosen = LogSelection(topics, self.robot, frames)
        check_options(self.log, flags, chosen)
        if self.log is None:
            raise InputError(
                "log", "found nothing", "a CARMEN file, a graph, a bag, the folder of a run, an MRCLAM folder"
            )
        check_out(self.log, self.out)
        from sixthsense.running.runs import RunHooks, replay_log

        prior = self.prior_start()
        found = open_recorded(self.log, self.settings, self.relations, chosen)
        for note in found.notes:
            announce(f"note: {found.name}: {note}")
        stem = f"{found.name.split('.')[0]}-{found.config.estimator}"
        with run_folder(self, found.config, stem, found.files, prior) as folder, live_view(self) as hooks:
            return show_end(replay_log(found, folder, RunHooks(hooks, say=announce), prior), self)


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
        """The configuration of the first run; InputError for other than two, and for what is no folder of a run."""
        from sixthsense.config.files import instead_of
        from sixthsense.logs import is_run_folder
        from sixthsense.logs.replay_input import base_of

        runs = given.get("runs", ())
        if len(runs) != 2:
            raise InputError("runs", f"found {' '.join(runs) or 'nothing'}", "the folders of two runs")
        for run in runs:
            if not is_run_folder(Path(run)):
                raise InputError(run, f"found {instead_of(Path(run), 'config.toml')}", "the folder of a run")
        return base_of(runs[0])

    def run(self, flags: Table) -> int:
        """Merge two runs."""
        from sixthsense.logs.replay_input import LogSelection, check_options, check_out

        first, second = self.runs
        check_options(first, flags, LogSelection())
        for run in self.runs:
            check_out(run, self.out)
        from sixthsense.running.merging import open_merged, replay_merged
        from sixthsense.running.runs import RunHooks

        announce(f"looking for {second} in the map of {first}")
        merged = open_merged(Path(first), Path(second), self.settings)
        for note in merged.notes:
            announce(f"note: {note}")
        with run_folder(self, merged.config, merged.name, merged.files) as folder, live_view(self) as hooks:
            return show_end(replay_merged(merged, folder, RunHooks(hooks, say=announce)), self)
