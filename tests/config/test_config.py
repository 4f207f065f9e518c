import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from settings import changed, flat, nested

from sixthsense.config import PRESETS, Config, Section, load_config, merge, notes_of, preset, save_config
from sixthsense.config.errors import InputError
from sixthsense.config.parts import ESTIMATORS
from sixthsense.config.tree import task_of


def written(folder: Path, text: str | bytes) -> Path:
    file = folder / "some.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


@pytest.mark.parametrize("name", PRESETS)
def test_a_saved_configuration_is_read_back_as_it_was_with_its_notes(name: str, tmp_path: Path) -> None:
    config = preset(name).replaced(seed=2**40, goal=(0.1, 1 / 3), start=(1e-300, -2.0, math.pi))
    file, note = tmp_path / "config.toml", {"name": "first", "pose": [0.1, 0.2, 0.3]}
    save_config(config, file)
    assert load_config(file) == config and config.preset == name
    assert notes_of(file).keys() == {"versions"}
    save_config(config, file, {"log": "a.log"}, note)
    notes = notes_of(file)
    assert load_config(file) == config and notes["replayed"] == {"log": "a.log"} and notes["prior_map"] == note
    table = tomllib.loads(file.read_text())
    assert table["replayed"] == {"log": "a.log"} and "region" not in table


@pytest.mark.parametrize("name", changed())
def test_a_file_changes_the_field_that_it_names_and_what_follows_from_it(name: str, tmp_path: Path) -> None:
    value = changed()[name]
    before = preset(value) if name == "preset" else Config()
    save_config(merge(before, nested({name: value})), tmp_path / "whole.toml")
    (tmp_path / "part.toml").write_text(f"{name.replace('_', '-')} = {toml(value)}\n")
    implied = {"front_end": {"estimator": "isam2"}, "no_odometry": {"estimator": "isam2", "front_end": "scan-matching"}}
    for file in ("whole.toml", "part.toml"):
        assert flat(load_config(tmp_path / file)) == flat(before) | {name: value} | implied.get(name, {}), file


def toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml, value))}]"
    return f"'{value}'" if isinstance(value, str) else str(value).lower()


def test_defaults_that_are_not_checked_when_a_section_is_made_are_allowed() -> None:
    for made in (Config(), *(value for _, value in Config() if isinstance(value, Section))):
        assert type(made).model_validate(dict(made)) == made and not made.model_fields_set


STATED = {
    "worn": {"world.wheel_scale_error": 0.02, "world.drift_rad_per_m": 0.5 * math.pi / 180.0},
    "report": {
        "estimator": "ekf", "robot.speed": 0.1, "robot.turn_rate": 0.5, "laser.beams": 180, "laser.max_range": 5.0,
        "robot.control_period_s": 1 / 60, "laser.period_ticks": 10, "world.motion.distribution": "uniform",
        "world.laser.range_m": 0.01, "world.laser.bearing_rad": 0.1 * math.pi / 180.0, "features.landmarks": "corners",
        "association.match_gate": 20.0, "association.new_gate": 200.0, "grid.cell_m": 0.04, "max_time": 1800.0,
    },
}  # fmt: skip
"""what presets are for, as their sources state it"""


@pytest.mark.parametrize("name", STATED)
def test_a_preset_has_the_values_that_its_source_states(name: str) -> None:
    values = flat(preset(name))
    assert {field: values[field] for field in STATED[name]} == pytest.approx(STATED[name])
    if name == "report":
        assert preset(name).world.motion == preset(name).assumed.motion
        assert preset(name).world.laser == preset(name).assumed.laser


BAD_FIELDS = {
    "laser.beams": ('[laser]\nbeams = "many"', "'many'", "a whole number"),
    "seed": ("seed = true", "True", "a whole number"),
    "laser.beems": ("[laser]\nbeems = 3", "beems", "beams, fov, max_range"),
    "laser": ("laser = 3", "3", "a table"),
    "laser.max_range": ("[laser]\nmax_range = nan", "nan", "a finite number"),
    "laser.mount": ("[laser]\nmount = [1, 2]", "(1, 2)", "3 numbers"),
    "laser.fov": ("[laser]\nfov = 90", "90", "above 0 to 6.28319"),
    "tour": ("tour = []", "()", "a list, each 2 numbers"),
    "explore.return_home": ("[explore]\nreturn_home = 1", "1", "true or false"),
    "estimator": ('estimator = "ekff"', "'ekff'", "ekf"),
    "scene": ('scene = "a\\nb"', "'a\\nb'", "a text without line breaks"),
    "max_time": (f"max_time = 1{'0' * 400}", "1000", "a finite number"),
    "preset": ('preset = "no"', "'no'", "default, worn, noiseless, report, log"),
    "min_hits": ("[grid]\nmin_hits = 11", "11", "at most max_hits, 10"),
    "follow.distance_slack_m": ("[follow]\ndistance_slack_m = 0.06", "0.06", "above 0 to 0.05"),
    "laser.sweep_s": ("[laser]\nsweep_s = 0.101", "0.101", "at most 0.1, the time between two scans"),
    "goal": ("goal = [1, 2]\ntour = [[1, 2]]", "beside a tour", "one of the two"),
    "front_end": ("front_end = 'scan-matching'\nestimator = 'ekf'", "with estimator ekf", "with isam2"),
    "no_odometry": ("no_odometry = true\ncalibrate_wheels = true", "with calibrate_wheels", "with front_end"),
}


@pytest.mark.parametrize("field", BAD_FIELDS)
def test_a_wrong_field_is_one_line_with_file_field_value_and_what_is_allowed(field: str, tmp_path: Path) -> None:
    text, found, allowed = BAD_FIELDS[field]
    file = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_config(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ") and f"{field}: " in message and "\n" not in message
    assert found in message and f"allowed: {allowed}" in message


@pytest.mark.parametrize(("text", "said"), [
    ("seed = 1\nseed = 2", "is not TOML"), (b"\xff\xfe\x00", "'utf-8' codec can't decode"),
    ("a = " + "[" * 50_000, "is not TOML"), ("seed = " + "1" * 5_000, "is not TOML"),
])  # fmt: skip
def test_a_file_that_is_no_configuration_is_one_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    file = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_config(file)
    assert str(caught.value).startswith(f"{file}: {said}") and "\n" not in str(caught.value)


OWN = "lab.fading:Fading"
GOAL, TOUR = (1.0, 2.0), ((3.0, 4.0),)


@pytest.mark.parametrize(
    ("base", "given", "expected"),
    [
        ({"goal": GOAL}, {"tour": TOUR}, {"goal": None, "tour": TOUR}),
        ({"tour": TOUR}, {"goal": GOAL}, {"goal": GOAL, "tour": None}),
        ({"tour": TOUR}, {"goal": None}, {"goal": None, "tour": TOUR}),
        ({}, {"front_end": "scan-matching"}, {"estimator": "isam2"}),
        ({"estimator": OWN}, {"front_end": "scan-matching"}, {"estimator": OWN}),
        ({"estimator": OWN, "estimator_options": {"gain": 2.0}}, {"seed": 3}, {"estimator": OWN}),
        ({"estimator": "isam2"}, {"estimator": OWN}, {"estimator": OWN, "front_end": "landmarks"}),
        ({"front_end": "scan-matching"}, {"estimator": "ekf"}, {"front_end": "landmarks"}),
        ({"estimator": "isam2"}, {"estimator": "ekf"}, {"front_end": "landmarks", "estimator": "ekf"}),
        ({}, {"no-odometry": True}, {"front_end": "scan-matching", "estimator": "isam2"}),
    ],
)
def test_what_follows_from_a_named_field(base: Any, given: Any, expected: Any) -> None:
    values = flat(merge(merge(Config(), base), given))
    assert {name: values[name] for name in expected} == expected


def test_a_goal_or_a_tour_sets_its_task_and_contradicts_another() -> None:
    assert task_of({"seed": 3, "goal": None}) == {}
    assert task_of({"goal": GOAL}) == task_of({"goal": GOAL, "task": "goal"}) == {"task": "goal"}
    assert task_of({"tour": TOUR}) == {"task": "tour"}
    with pytest.raises(InputError, match=r"^tour: found with `task` explore, allowed: with `task` tour$"):
        task_of({"tour": TOUR, "task": "explore"})


def test_a_part_is_named_by_a_short_name_or_by_its_import_path() -> None:
    assert "ekf" in ESTIMATORS and "lab.fading:Fading" in ESTIMATORS and "lab:Own.Inner" in ESTIMATORS
    for bad in ("", "1a", "a b", "ukf", "lab.fading:", ":Fading", "lab/fading:Fading", 3):
        assert bad not in ESTIMATORS
    assert ESTIMATORS.name_of(Config) == "sixthsense.config.sections:Config" and ESTIMATORS.name_of("ekf") == "ekf"
    assert ESTIMATORS.load("sixthsense.config.sections:Config") is Config
    with pytest.raises(InputError, match=r"^estimator: found .*<lambda>, allowed: a class or function at the top"):
        ESTIMATORS.name_of(lambda: None)
    for name, said in (
        ("no_lab:A", "No module named 'no_lab'"),
        ("math:A", "no attribute 'A'"),
        ("math:pi", "a float"),
    ):
        with pytest.raises(InputError, match=f"^estimator: found {name}, which .*{said}"):
            ESTIMATORS.load(name)
