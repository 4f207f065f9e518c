"""Two runs in one building, mapped together."""

import dataclasses
import re
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config import merge
from sixthsense.config.errors import InputError
from sixthsense.logs.log import Log
from sixthsense.logs.replay_input import ReplayInput, open_recorded
from sixthsense.logs.runfolder import FILE, read_run
from sixthsense.loop import interrupt
from sixthsense.record.folder import RunFolder
from sixthsense.record.stream import RecordWriter
from sixthsense.running import merging
from sixthsense.running.merging import Merged, merged_log, replay_merged
from sixthsense.running.runs import QUIET
from sixthsense.verdict.evidence import contradicted_between
from sixthsense.verdict.verdict import Cause

pytestmark = pytest.mark.usefixtures("compiled", "here")

TOUR = {"task": "tour", "max_time": 16.0, "progress": False}
OTHER = """\
start = [-3.0, -3.0, 0.0]
radius = 0.15
region = [-9.0, -9.0, 9.0, 9.0]
tour = [[5.0, -3.0], [5.0, 4.0], [-3.0, 5.0]]
[[polygons]]
points = [[-9.0, -7.0], [9.0, -7.0], [9.0, 8.0], [-7.5, 6.0]]
[[polygons]]
points = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5]]
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with two tours of the apartment from different starts, and one elsewhere."""
    folder = tmp_path_factory.mktemp("runs")
    ss.run("apartment", seed=1, out=folder / "monday", **TOUR)
    ss.run("apartment", seed=2, start=(11.5, 0.9, 1.5), out=folder / "tuesday", **TOUR)
    (folder / "other.toml").write_text(OTHER)
    ss.run(folder / "other.toml", seed=3, out=folder / "other", **TOUR)
    return folder


def complaint(args, capsys, here):
    assert cli.main(["merge", *map(str, args)]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if not line.startswith("looking for ")]
    assert out == "" and len(lines) == 1
    assert [entry.name for entry in here.iterdir()] == []
    return lines[0].removeprefix("sixthsense: ")


def test_both_runs_are_in_one_frame_and_the_folder_is_that_of_a_run(runs, here, capsys):
    (here / "r.txt").write_text("1.5 5.5 0.5 0.2 0 0 0 0.3\n")
    folders = [str(runs / "monday"), str(runs / "tuesday")]
    assert cli.main(["merge", *folders, "--out", "both"]) == cli.DONE
    out, err = capsys.readouterr()
    assert "written to both/" in out and int(re.search(r"note: (\d+) links join both runs", err)[1]) > 5
    both, monday, tuesday = ss.load("both"), ss.load(runs / "monday"), ss.load(runs / "tuesday")
    assert len(both.trace.stamps_ns) == len(monday.trace.stamps_ns) + len(tuesday.trace.stamps_ns)
    assert both.trace.stamps_ns == sorted(both.trace.stamps_ns)
    driven = [run.metrics["path_length_m"] for run in (both, monday, tuesday)]
    assert driven[0] == pytest.approx(driven[1] + driven[2], abs=1e-6)
    assert both.trace.carried_scans() == [len(monday.trace.estimates)] and monday.trace.carried_scans() == []
    assert both.trace.config.front_end == "scan-matching"
    check_ticks(*(ss.open_log(folder, both.trace.config.laser).ticks for folder in ("both", *folders)))
    errors = np.array(both.trace.trajectory)[:, :2] - np.array(both.trace.key_truths)[:, :2]
    assert np.hypot(*errors.T).max() < 0.05
    own, first = both.trace.witnesses(), len(monday.trace.trajectory)
    between, alone = contradicted_between(own, first)
    assert between == pytest.approx(alone, abs=0.02)
    beside = own.trajectory + np.where(np.arange(len(own.trajectory))[:, None] < first, 0.0, [0.6, 0.0, 0.0])
    assert contradicted_between(dataclasses.replace(own, trajectory=beside), first)[0] > alone + 0.1
    again = ss.replay("both", relations="r.txt", progress=False)
    assert again.trace.relations.stamps.tolist() == [[1.5, 5.5]] and again.metrics["relations_trans_m_mean"] > 0.0
    assert np.allclose(again.trace.trajectory, both.trace.trajectory, atol=1e-9)


def check_ticks(both, monday, tuesday):
    """The second run has its own motions after a step that is as uncertain as what was driven says."""
    first, second = both[: len(monday)], both[len(monday) :]
    assert [(tick.stamp_ns, tick.odometry) for tick in first] == [(tick.stamp_ns, tick.odometry) for tick in monday]
    shift_ns = second[0].stamp_ns - tuesday[0].stamp_ns
    assert second[0].stamp_ns == first[-1].stamp_ns + 1_000_000_000
    T_first_second = second[0].odometry @ tuesday[0].odometry.inverse()
    for one, two in zip(second, tuesday, strict=True):
        assert one.stamp_ns == two.stamp_ns + shift_ns and one.truth == two.truth
        assert one.odometry.array() == pytest.approx((T_first_second @ two.odometry).array(), abs=1e-9)
    assert all(tick.increment_cov is None for tick in (*first, *second[1:]))
    cov = second[0].increment_cov
    sigmas = np.sqrt(np.diag(cov))
    driven_m = (sigmas[0] - 0.3) / 0.02
    assert 0.4 < driven_m < 13.0 and sigmas == pytest.approx([0.3 + 0.02 * driven_m] * 2 + [0.1 + 0.002 * driven_m])
    assert np.count_nonzero(cov) == 3
    step = (first[-1].odometry.inverse() @ second[0].odometry).array()
    true = (first[-1].truth.inverse() @ second[0].truth).array()
    assert np.abs(step - true).max() < 0.1


def recorded(folder) -> ReplayInput:
    config = merge(ss.load_config(folder / "config.toml"), {"front_end": "scan-matching"})
    return open_recorded(folder, config.replaced(max_time=None))


def joined(one: ReplayInput, other: ReplayInput) -> Merged:
    """The first six seconds of both, the second where it truly was; the first was carried once, as a merged one."""
    first, second = ([*run.log.ticks[:300]] for run in (one, other))
    unknown = np.diag([0.1, 0.1, 0.02])
    first[10] = dataclasses.replace(first[10], increment_cov=unknown)
    last, begin = first[-1], second[0]
    T_first_second = last.odometry @ last.truth.inverse() @ begin.truth @ begin.odometry.inverse()
    later_ns = last.stamp_ns + 1_000_000_000
    moved = [
        dataclasses.replace(tick, stamp_ns=tick.stamp_ns + later_ns, odometry=T_first_second @ tick.odometry)
        for tick in second
    ]
    moved[0] = dataclasses.replace(moved[0], increment_cov=unknown)
    log = Log([*first, *moved], one.log.laser)
    return Merged("both", log, one.config, None, one.files, (), moved[0].stamp_ns)


def test_a_second_run_that_no_link_joins_to_a_first_one_that_was_carried_is_refused(runs, here, monkeypatch):
    monday = recorded(runs / "monday")
    assert replay_merged(joined(monday, monday), None, QUIET).outcome == "log ended"
    with RunFolder(here / "both", monday.config) as folder, pytest.raises(InputError, match="could be linked"):
        replay_merged(joined(monday, recorded(runs / "other")), folder, QUIET)
    assert list(here.iterdir()) == []
    monkeypatch.setattr(interrupt._signals, "ctrl_c_s", -np.inf)
    press = dataclasses.replace(QUIET, on_tick=lambda tick, trace: len(trace.stamps_ns) == 5 and signal.raise_signal(2))
    interrupted = replay_merged(joined(monday, recorded(runs / "other")), None, press)
    assert interrupted.outcome == "interrupted" and interrupted.verdict.level == "unjudged"


def test_runs_that_contradict_each_other_more_than_each_itself_are_refused(runs, here, monkeypatch):
    monday = recorded(runs / "monday")
    monkeypatch.setattr(merging, "contradicted_between", lambda found, first: (0.13, 0.01))
    with RunFolder(here / "both", monday.config) as folder, pytest.raises(InputError, match=r"13% .* itself 1%, allow"):
        replay_merged(joined(monday, monday), folder, QUIET)
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("laser", "said"),
    [({"beams": 181}, "laser.beams 181, allowed: 360"), ({"fov": 3.0}, "laser.fov 3"), (None, "scans")],
)
def test_runs_of_two_lasers_and_runs_without_scans_are_not_merged(laser, said, runs):
    one = recorded(runs / "monday")
    config = merge(one.config, {"laser": laser or {}})
    log = one.log if laser else Log([dataclasses.replace(tick, scan=None) for tick in one.log.ticks])
    with pytest.raises(InputError, match=said):
        merged_log(one, dataclasses.replace(one, config=config, log=log))


def test_runs_of_two_buildings_are_not_merged(runs, here, capsys):
    line = complaint([runs / "monday", runs / "other", "--out", "both"], capsys, here)
    assert line.startswith("other: found no place of monday that alone fits what was seen, allowed: two runs")


def test_a_run_is_not_merged_with_itself(runs, here, capsys):
    line = complaint([runs / "monday", runs / "other" / ".." / "monday", "--out", "both"], capsys, here)
    assert "found the first run again, whose scans would count twice" in line


def test_a_broken_run_is_refused_with_its_cause(runs, here):
    shutil.copytree(runs / "tuesday", "broken")
    judged = ss.load("broken").trace
    cause = Cause("mirrored", "is the laser mirrored?", 1.5, 22.5, np.zeros((0, 2)))
    judged.verdict = dataclasses.replace(judged.verdict, level="broken", causes=(cause,))
    ticks = read_run("broken", judged.config.laser).ticks
    record = RecordWriter(Path("broken") / FILE)
    for tick in ticks:
        record(tick, judged)
    record.end(judged, {})
    with pytest.raises(InputError, match=r"broken: is the laser mirrored\?"):
        ss.merge_runs(runs / "monday", "broken", progress=False)
