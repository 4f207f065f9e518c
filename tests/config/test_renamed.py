"""Names of earlier versions are still read, with a note that names the new one."""

import json
from pathlib import Path

import pytest
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.config import Config, ConfigError, merge
from sixthsense.config.removed import RENAMED, RENAMED_VALUES, RenamedWarning

OLD = {
    "keyscans": {"distance_m": 0.5},
    "scans": {"revisits": False},
    "explore": {"revisit": False, "revisit_sigma_m": 0.2},
    "association": {"proposed_by": "scans"},
    "estimator": "isam2",
    "front_end": "scans",
}


def test_old_fields_and_values_set_the_new_ones_with_a_note_each() -> None:
    with pytest.warns(RenamedWarning) as noted:
        config = ss.preset(**OLD)
    assert config.keyframes.distance_m == 0.5 and not config.scans.loop_closures
    assert not config.explore.loop_closure and config.explore.loop_closure_sigma_m == 0.2
    assert (config.front_end, config.association.proposed_by) == ("scan-matching", "scan-matching")
    assert len(noted) == len(RENAMED) + len(RENAMED_VALUES)
    assert "keyscans is now called keyframes" in {str(note.message) for note in noted}


def test_old_options_and_values_are_read_with_a_note(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--keyscans.turn-rad", "0.3", "--scans.no-revisits", "--front-end", "scans", "--max-time", "1"]
    assert main(["run", "rectangle", "--task", "tour", *options, "--out", str(tmp_path / "run")]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if line.startswith("note: ")]
    assert notes == [
        "note: --keyscans.turn-rad is now called --keyframes.turn-rad",
        "note: --scans.no-revisits is now called --scans.no-loop-closures",
        "note: front_end scans is now called scan-matching",
    ]
    config = ss.load_config(tmp_path / "run" / "config.toml")
    assert config.keyframes.turn_rad == 0.3 and not config.scans.loop_closures and config.front_end == "scan-matching"


def test_a_run_folder_of_before_loads_and_replays(tmp_path: Path) -> None:
    """The same run with the names that earlier versions wrote, in record, arrays, table and configuration."""
    import numpy as np

    made = ss.run("rectangle", task="tour", max_time=6.0, out=tmp_path / "run")
    folder = tmp_path / "run"
    old = {'"keyframe":': '"key_scan":', '"observations":': '"sightings":', '"loop_closures":': '"revisits":'}
    text = (folder / "record.jsonl").read_text()
    for new, name in old.items():
        assert new in text
        text = text.replace(new, name)
    (folder / "record.jsonl").write_text(text)
    config = (folder / "config.toml").read_text()
    (folder / "config.toml").write_text(config.replace("[keyframes]", "[keyscans]").replace("loop_closure", "revisit"))
    arrays = dict(np.load(folder / "record.npz"))
    arrays["sightings"] = arrays.pop("observations")
    np.savez_compressed(folder / "record.npz", **arrays)
    with pytest.warns(RenamedWarning):
        loaded = ss.load(folder)
    assert loaded.trace.records.keys() == made.trace.records.keys()
    assert [a.observations.keys() for a in loaded.trace.associations] == [
        a.observations.keys() for a in made.trace.associations
    ]
    same = json.loads((folder / "metrics.json").read_text())
    assert loaded.metrics["ate_rmse_m"] == pytest.approx(same["ate_rmse_m"])
    with pytest.warns(RenamedWarning):
        again = ss.replay(folder)
    assert again.metrics["ate_rmse_m"] == pytest.approx(same["ate_rmse_m"], abs=1e-6)


def test_old_keys_of_metrics_give_the_new_ones() -> None:
    from sixthsense.evaluation.results import Metrics

    metrics = Metrics({"loop_closures_found": 3})
    with pytest.warns(RenamedWarning, match="revisits_found is now called loop_closures_found"):
        assert metrics["revisits_found"] == 3
    with pytest.raises(KeyError, match="did you mean loop_closures_found"):
        metrics["loop_closure_found"]


@pytest.mark.parametrize(
    ("old", "now"),
    [
        ({"method": "chi2", "match_probability": 0.99}, {"match_gate": pytest.approx(chi2.ppf(0.99, 2))}),
        ({"new_probability": 0.9999, "culling": True}, {"new_gate": pytest.approx(chi2.ppf(0.9999, 2))}),
        ({"method": "report", "match_below": 9.0, "assignment": "optimal"}, {"match_gate": 9.0, "new_gate": 200.0}),
        ({"culling": False}, {"cull_below": 0}),
    ],
)
def test_gates_of_earlier_versions_are_squared_distances(old: dict[str, object], now: dict[str, object]) -> None:
    with pytest.warns(RenamedWarning):
        association = merge(Config(), {"association": old}).association
    assert {name: getattr(association, name) for name in now} == now


@pytest.mark.parametrize(
    "old",
    [{"method": "nearest"}, {"match_probability": 1.5}, {"match_probability": 0.99, "match_gate": 9.0}],
)
def test_gates_of_earlier_versions_that_say_nothing_are_one_line(old: dict[str, object]) -> None:
    with pytest.warns(RenamedWarning), pytest.raises(ConfigError, match=r"^association\.\w+: found .*, allowed: "):
        merge(Config(), {"association": old})
