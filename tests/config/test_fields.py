"""The typed dictionaries of keyword arguments say what the configuration takes; sections know what was stated."""

import inspect
import pickle
from pathlib import Path

import rewrite_fields

import sixthsense as ss
from sixthsense.config import LaserNoise, MotionNoise

CALLS = {ss.run: "Run", ss.replay: "Replay", ss.merge_runs: "Merge", ss.campaign: "Campaign", ss.preset: ""}


def test_the_typed_fields_are_those_of_the_configuration() -> None:
    assert rewrite_fields.FILE.read_text("utf-8") == rewrite_fields.text()
    for call, name in CALLS.items():
        (taken,) = (one for one in inspect.signature(call).parameters.values() if one.kind is one.VAR_KEYWORD)
        assert taken.annotation == f"Unpack[{name}Fields]"


def test_what_a_section_states_replaces_the_preset_and_all_else_stays() -> None:
    report = ss.preset("report")
    laser, motion = ss.LaserConfig(fov=2.5), MotionNoise(distribution="uniform", turn_rate=0.3)
    world = ss.WorldConfig(motion=motion, laser=LaserNoise(bearing_rad=0.02))
    table = {
        "laser": {"fov": 2.5},
        "world": {"motion": {"distribution": "uniform", "turn_rate": 0.3}, "laser": {"bearing_rad": 0.02}},
    }
    found = ss.preset("report", laser=laser, world=world)
    assert found == ss.preset("report", **table) == ss.merge(report, table)  # type: ignore[arg-type]
    assert found.laser == report.laser.replaced(fov=2.5) and found.laser.beams == 180
    # A value that is the default's counts, too.
    assert ss.merge(report, {"laser": ss.LaserConfig(beams=360)}).laser.beams == 360


def test_a_section_knows_what_was_stated(tmp_path: Path) -> None:
    assert ss.LaserConfig(beams=360, max_range=4.5).model_fields_set == {"beams", "max_range"}
    assert ss.preset("report").laser.model_fields_set == ss.Config().laser.model_fields_set == set()
    once = ss.merge(ss.preset("report"), {"laser": {"max-range": 4.5}})
    twice = ss.merge(once, {"seed": 3, "laser": {"beams": 90}})
    assert once.laser.model_fields_set == {"max_range"} and twice.laser.model_fields_set == {"beams", "max_range"}
    assert twice.as_implied() == twice and twice.as_implied().laser.model_fields_set == set()
    assert pickle.loads(pickle.dumps(twice)).laser.model_fields_set == {"beams", "max_range"}
    (tmp_path / "part.toml").write_text("laser.fov = 2.0\n")
    assert ss.load_config(tmp_path / "part.toml", twice).laser.model_fields_set == {"beams", "fov", "max_range"}
    for replayed, count in ((None, 0), ({"log": "a.log"}, len(ss.LaserConfig.model_fields))):
        ss.save_config(twice, tmp_path / "saved.toml", replayed)
        assert len(ss.load_config(tmp_path / "saved.toml").laser.model_fields_set) == count
