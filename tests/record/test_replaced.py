"""A run replaces an earlier run, and nothing else."""

from pathlib import Path

import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config import Config, load_config
from sixthsense.record.folder import RunFolder

pytestmark = pytest.mark.usefixtures("compiled", "here")

RUN = ("run", "rectangle", "--task", "tour", "--max-time", "2")


def content(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def complaint(args: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(args) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and err.startswith("sixthsense: ")
    return err.removeprefix("sixthsense: ").strip()


def seed_of(folder: Path) -> int:
    return load_config(folder / "config.toml").seed


FOREIGN = {
    "cargo": {"config.toml": "[net]\n", "registry/index": "crates"},
    "settings": {"config.toml": "seed = 3\n"},
    "saved settings": {"config.toml": "seed = 3\n[versions]\nsixthsense = '0.1'\n"},
    "notes": {"notes.txt": "mine"},
    "a figure": {"figures/mine.png": "mine"},
    "a second bag": {"bag/bag_1.mcap": "mine"},
    "a folder": {"more/": ""},
    "a folder named as a file": {"map.pgm/": ""},
}


@pytest.mark.parametrize("name", FOREIGN)
def test_what_no_run_has_written_is_never_removed(name, here, capsys):
    out = here / "x"
    if not name.startswith(("cargo", "settings", "saved")):
        ss.run("rectangle", task="tour", max_time=2.0, out=out)
        (out / "map.pgm").unlink()
    for file, text in FOREIGN[name].items():
        if file.endswith("/"):
            (out / file).mkdir(parents=True)
        else:
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            (out / file).write_text(text)
    before = content(here)
    said = complaint((*RUN, "--out", "x", "--overwrite"), capsys)
    assert said.startswith("--out: x is not a run folder, it holds ") and "allowed: " in said
    assert content(here) == before


def test_the_second_of_two_runs_into_one_folder_is_told(here, capsys):
    with RunFolder(here / "x", Config(seed=1)) as first:
        said = complaint((*RUN, "--out", "x"), capsys)
        assert said == "--out: found another process that writes x, allowed: another folder, or wait for its end"
        assert seed_of(first.partial) == 1
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert seed_of(here / "x") == 2


def test_what_a_killed_run_has_recorded_is_kept_under_another_name_and_the_user_is_told(here, capsys):
    ss.run("rectangle", task="tour", max_time=2.0, seed=1, out="x")
    (here / "x").rename(here / "x.partial")
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert "note: x.partial of a killed run is kept as x.1.partial\n" in capsys.readouterr().err
    assert (seed_of(here / "x"), seed_of(here / "x.1.partial")) == (2, 1)
    assert len(ss.load("x.1.partial").trace.estimates) > 10
    (here / "x.1.partial").rename(here / "y.partial")
    with pytest.warns(UserWarning, match=r"y.partial of a killed run is kept as y.1.partial"):
        ss.run("rectangle", task="tour", max_time=2.0, out="y")


def test_an_old_run_is_restored_where_the_new_one_cannot_take_its_name(here, monkeypatch):
    ss.run("rectangle", task="tour", max_time=2.0, seed=1, out="x")
    rename = Path.rename

    def failing(path: Path, target: Path) -> Path:
        if path.name == "x.partial":
            raise PermissionError(13, "Permission denied")
        return rename(path, target)

    with monkeypatch.context() as patch, pytest.raises(PermissionError):
        patch.setattr(Path, "rename", failing)
        ss.run("rectangle", task="tour", max_time=2.0, seed=2, out="x", overwrite=True)
    assert (seed_of(here / "x"), seed_of(here / "x.partial")) == (1, 2)
    assert sorted(path.name for path in here.iterdir()) == ["x", "x.partial"]


@pytest.mark.parametrize("new_has_its_name", [False, True])
def test_a_replacement_that_was_killed_is_completed_by_the_next_run(new_has_its_name, here):
    for name, seed in (("x" if new_has_its_name else "x.partial", 2), (".x.replaced", 1)):
        ss.run("rectangle", task="tour", max_time=2.0, seed=seed, out=here / name)
    if new_has_its_name:
        (here / ".x.replaced" / "config.toml").unlink()  # half removed
    folder = RunFolder(here / "x", Config(seed=3), overwrite=True)
    assert seed_of(here / "x") == (2 if new_has_its_name else 1)
    assert len(folder.notes) == (0 if new_has_its_name else 2)
    assert not (here / ".x.replaced").exists()
    assert (here / "x.1.partial").exists() is not new_has_its_name
