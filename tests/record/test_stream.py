"""A record that is written while a run goes on, and the log that it is."""

import numpy as np
import pytest

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.evaluation.measure import measure
from sixthsense.logs.log import Log
from sixthsense.logs.runfolder import FILE, read_run
from sixthsense.loop.run import replay, run
from sixthsense.record.stream import RecordWriter
from sixthsense.record.trace import Trace

CONFIG = preset(task="tour", scene="rectangle", max_time=12.0, laser={"mount": [0.1, -0.05, 0.3], "max_range": 7.3})
SCAN = Scan.from_config(np.linspace(1.5, 4.5, CONFIG.laser.beams), CONFIG.laser)


def test_a_run_replays_to_the_same_estimates_covariances_and_errors(tmp_path):
    record = RecordWriter(tmp_path / FILE)
    trace = run(CONFIG, record)
    record.close()
    log = read_run(tmp_path, CONFIG.laser)
    assert all(np.array_equal(a, b) for (_, a), b in zip(log.paths("plan"), trace.plans, strict=True))
    again = replay(log, CONFIG)
    assert np.array_equal(np.array(again.estimates), np.array(trace.estimates))
    assert np.array_equal(again.joint_cov, trace.joint_cov)
    figures, before = measure(again), measure(trace)
    driving = ("outcome", "plans", "plans_below_margin", "guard_stops")
    steady = [key for key in before if "_ms_" not in key and "time" not in key and key not in driving]
    assert {key: figures[key] for key in steady} == {key: before[key] for key in steady}


def test_a_log_keeps_its_own_stamps_beside_the_clock(tmp_path):
    """They differ where a log's clock runs backwards, and relations name scans by them."""
    laser = LaserConfig(beams=4)
    scan = Scan.from_config(np.array([1.0, 2.0, np.inf, 3.0]), laser)
    own = [976052857.33772, 976052857.12, 976052858.0, 3e9]
    clock = [976052857337720000, 976052857337720001, 976052858000000000, 3 * 10**18]
    ticks = [Tick(c, Pose(k, 0, 0), scan, log_stamp_s=s) for k, (c, s) in enumerate(zip(clock, own, strict=True))]
    record = RecordWriter(tmp_path / FILE)
    replay(Log(ticks), preset("log", laser={"beams": 4}), None, record)
    record.close()
    log = read_run(tmp_path, laser)
    assert [tick.stamp_ns for tick in log.ticks] == clock
    assert [tick.log_stamp_s for tick in log.ticks] == own


def test_a_record_that_was_cut_is_read_up_to_its_last_whole_chunk_and_the_log_says_how_far(tmp_path):
    ticks = [Tick(k * 1_100_000_000 + 7, Pose(0.3 * k, 0.2, 0.1), SCAN) for k in range(1, 14)]
    record, trace = RecordWriter(tmp_path / FILE), Trace(CONFIG, None, 0.23)
    for tick in ticks:
        record(tick, trace)
        record._flush()
    record.close()
    assert not read_run(tmp_path, CONFIG.laser).found
    file = tmp_path / FILE
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    log = read_run(tmp_path, CONFIG.laser)
    used = [tick.stamp_ns for tick in log.ticks]
    assert 2 < len(used) < len(ticks) and used == [tick.stamp_ns for tick in ticks[: len(used)]]
    assert [str(finding) for finding in log.found] == [
        f"the recording is incomplete; its first {1.1 * (len(used) - 1):.1f} s are used"
    ]


@pytest.mark.parametrize("explorer", ["frontier", "random"])
def test_the_tours_of_an_exploration_are_in_its_record(tmp_path, explorer):
    config = preset(task="explore", scene="rectangle", max_time=20.0, laser={"max_range": 2.0}, explorer=explorer)
    record = RecordWriter(tmp_path / FILE)
    trace = run(config, record)
    record.close()
    tours = read_run(tmp_path, config.laser).paths("tour")
    assert len(tours) == len(trace.tours) and bool(tours) == (explorer == "frontier") and trace.plans
    assert all(np.array_equal(a, b) for (_, a), b in zip(tours, trace.tours, strict=True))
    assert all(np.allclose(tour[-1], trace.estimates[0][:2]) for _, tour in tours)  # home
