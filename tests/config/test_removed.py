import dataclasses
from pathlib import Path

import pytest
import tomli_w

from sixthsense.cli import main
from sixthsense.config import Config, ConfigError, Section, as_table, load_config, preset
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
def test_a_removed_field_is_ignored_at_its_default_and_told_in_one_line_otherwise(name: str, tmp_path: Path) -> None:
    assert load_config(old_file(tmp_path, name, REMOVED[name].default)) == Config(seed=7)
    assert not has_field(Config(), name)
    file = old_file(tmp_path, name, 17)
    with pytest.raises(ConfigError) as error:
        load_config(file)
    assert str(error.value).startswith(f"{file}: {name}: found 17; was removed: ")
    assert str(error.value).endswith("; allowed: leave it out") and "\n" not in str(error.value)


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
