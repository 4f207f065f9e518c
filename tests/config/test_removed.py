import dataclasses
from pathlib import Path

import pytest
import tomli_w

from sixthsense.cli import main
from sixthsense.config import Config, ConfigError, Section, as_table, load_config, preset, save_config
from sixthsense.config.removed import REMOVED, REMOVED_PRESETS


def old_file(folder: Path, name: str, value: object) -> Path:
    """A whole configuration as an earlier version saved it."""
    section, field = name.split(".")
    table = as_table(Config(seed=7))
    table[section][field] = value
    file = folder / "config.toml"
    file.write_text(tomli_w.dumps(table))
    return file


def has_field(section: Section, name: str) -> bool:
    first, _, rest = name.partition(".")
    if first not in {f.name for f in dataclasses.fields(section)}:  # type: ignore[arg-type]
        return False
    return not rest or has_field(getattr(section, first), rest)


@pytest.mark.parametrize("name", REMOVED)
def test_a_removed_field_at_its_default_is_ignored_in_an_old_file(name: str, tmp_path: Path) -> None:
    assert load_config(old_file(tmp_path, name, REMOVED[name].default)) == Config(seed=7)
    assert not has_field(Config(), name)


@pytest.mark.parametrize("name", REMOVED)
def test_any_other_value_of_a_removed_field_is_one_line_that_says_so(name: str, tmp_path: Path) -> None:
    file = old_file(tmp_path, name, 17)
    with pytest.raises(ConfigError) as error:
        load_config(file)
    assert str(error.value).startswith(f"{file}: {name}: found 17; was removed: ")
    assert str(error.value).endswith("; allowed: leave it out") and "\n" not in str(error.value)


def test_a_file_may_write_a_removed_field_with_hyphens(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[association]\ncandidate-sightings = 1\npre-gate-m = 2.0\n")
    assert load_config(file).association.pre_gate_m == 2.0
    file.write_text("[association]\ncandidate-sightings = true\n")
    with pytest.raises(ConfigError, match="found True; was removed"):
        load_config(file)


def test_a_saved_configuration_holds_no_removed_field(tmp_path: Path) -> None:
    save_config(Config(), tmp_path / "config.toml")
    text = (tmp_path / "config.toml").read_text()
    assert not any(name.rpartition(".")[2] in text for name in REMOVED)


def test_the_command_line_exits_with_2_and_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = old_file(tmp_path, "association.candidate_sightings", 3)
    assert main(["run", "--config", str(file), "--out", str(tmp_path / "run")]) == 2
    assert not (tmp_path / "run").exists()
    said = capsys.readouterr().err.strip()
    assert "candidate_sightings: found 3; was removed: " in said and "\n" not in said


@pytest.mark.parametrize("name", REMOVED_PRESETS)
def test_a_removed_preset_is_one_line_that_says_what_to_use_instead(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match=f"preset: found '{name}'; was removed: .*; allowed: leave it out"):
        preset(name)
    assert main(["replay", "some.log", "--preset", name, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err.strip()
    assert f"found '{name}'; was removed: " in said and "\n" not in said
    (tmp_path / "mine.toml").write_text(f'preset = "{name}"\nseed = 3\n')
    with pytest.raises(ConfigError, match=r"mine\.toml: preset: found"):
        load_config(tmp_path / "mine.toml")


@pytest.mark.parametrize("name", REMOVED_PRESETS)
def test_a_saved_configuration_of_a_removed_preset_keeps_all_its_values(name: str, tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    save_config(preset(seed=7, assumed={"drift_rad_per_m": 0.05}), file)
    file.write_text(file.read_text().replace('preset = "default"', f'preset = "{name}"'))
    assert load_config(file) == preset(seed=7, assumed={"drift_rad_per_m": 0.05})
