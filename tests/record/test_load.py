"""A run's folder read back without estimating again: equal to the run, or a word on what is missing."""

import json

import pytest
from mcap.reader import make_reader

import sixthsense as ss
from sixthsense.evaluation.measure import measure
from sixthsense.figures.run import Run
from sixthsense.logs.runfolder import FILE


@pytest.fixture(scope="module", params=["ekf-invariant", "isam2"])
def simulated(request, tmp_path_factory) -> Run:
    out = tmp_path_factory.mktemp("runs") / "one"
    return ss.run("rectangle", estimator=request.param, preset="worn", seed=1, out=out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short tour's folder, whose record has a chunk for each tick."""
    out = tmp_path_factory.mktemp("runs") / "tour"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sixthsense.record.stream._FLUSH_S", 0.0)
        ss.run("rectangle", task="tour", max_time=6.0, seed=4, out=out)
    return out


def refuse(constant: str) -> None:
    raise AssertionError(constant)


def test_a_simulated_run_is_read_back_with_its_metrics_which_are_strict_json(simulated):
    loaded = ss.load(simulated.folder)
    stated = json.loads((simulated.folder / "metrics.json").read_text(), parse_constant=refuse)
    assert loaded.missing == ()
    assert loaded.metrics == stated
    assert loaded.verdict.level == simulated.verdict.level
    assert json.loads(json.dumps(measure(loaded.trace))) == stated


def test_a_record_is_whole_for_programs_that_read_mcap(folder):
    with (folder / FILE).open("rb") as stream:
        summary = make_reader(stream).get_summary()
        found = [message for _, channel, message in make_reader(stream).iter_messages(topics=["end"])]
    counts = {channel.topic: summary.statistics.channel_message_counts[k] for k, channel in summary.channels.items()}
    trace = ss.load(folder).trace
    assert counts["estimate"] == counts["scan"] == len(trace.stamps_ns)
    assert counts["keyframe"] == len(trace.key_stamps_ns)
    assert json.loads(found[0].data)["fields"]["outcome"] == trace.outcome
