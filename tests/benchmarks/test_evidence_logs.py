"""The table of scan matching on logs: what is run, what is asked, and what it says of missing and failed runs."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def script(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    found = importlib.import_module("evidence_logs")
    monkeypatch.setattr(found, "JSON", tmp_path / "evidence_logs.json")
    return found


def test_every_case_has_a_key_of_its_own_and_every_line_finds_its_cases(script):
    every = script.cases(1)
    found = {case.key: {"failed": "tried"} for case in every}
    assert len(found) == len(every)
    table = list(script.lines(found, [1]))
    assert {line.measured for line in table} == {"tried"}
    assert {line.met for line in table} == {"NO"}
    for kind in ("command", "clean", "damages", "nees", "repetition", "coarse"):
        assert any(case.key.startswith(kind) for case in every)


def test_rows_that_were_not_measured_are_empty(script):
    assert {(line.measured, line.met) for line in script.lines({}, [1])} == {("", "")}


def test_a_damage_is_judged_by_its_error_its_largest_error_and_its_time_beside_the_log_itself(script):
    def met(mean_m: float, largest_m: float, processor_s: float) -> str:
        own = {"mean_m": mean_m, "largest_m": largest_m, "processor_s": processor_s}
        clean = {"mean_m": 0.03, "largest_m": 0.2, "processor_s": 10.0}
        found = {"damages.aces.clean.1": clean, "damages.aces.gaps.1": own}
        (line,) = [line for line in script.lines(found, [1]) if line.what.startswith("damages, aces, gaps")]
        return line.met

    assert met(0.032, 0.5, 15.0) == "yes"
    assert met(0.045, 0.5, 15.0) == met(0.032, 0.6, 15.0) == met(0.032, 0.5, 15.1) == "NO"


def test_a_case_that_raises_is_reported_one_cut_short_ends_the_command_and_neither_is_kept(
    script, monkeypatch, tmp_path
):
    def raising(case):
        raise ValueError("link 3\nand more")

    monkeypatch.setattr(script, "figures_of", raising)
    assert script.measured(tmp_path, script.Case("clean", ("aces",))) == {"failed": "ValueError: link 3"}
    monkeypatch.setattr(script, "figures_of", lambda case: {"outcome": "interrupted"})
    with pytest.raises(KeyboardInterrupt):
        script.measured(tmp_path, script.Case("clean", ("aces",)))
    monkeypatch.setattr(script, "figures_of", lambda case: {"mean_m": 1.0})
    assert script.measured(tmp_path, script.Case("clean", ("aces",))) == {"mean_m": 1.0}
    monkeypatch.setattr(script, "figures_of", raising)
    assert script.measured(tmp_path, script.Case("clean", ("aces",))) == {"mean_m": 1.0}


@pytest.mark.parametrize(("rows", "named"), [("clean", "SIXTHSENSE_DATA"), ("claen", "--rows: found 'claen'")])
def test_missing_data_and_unknown_rows_are_named_in_one_line(script, monkeypatch, capsys, rows, named):
    monkeypatch.delenv("SIXTHSENSE_DATA", raising=False)
    monkeypatch.setattr("sys.argv", ["evidence_logs.py", "--rows", rows])
    assert script.main() == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert named in error
