"""A run replaces an earlier run, and nothing else."""

import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config import Config, load_config
from sixthsense.figures.panels import KINDS
from sixthsense.record.contents import FIGURES, reason_not_a_run
from sixthsense.record.folder import FolderError, RunFolder
from sixthsense.record.folder_lock import FolderInUseError, FolderLock

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


def test_a_run_with_its_whole_report_may_be_replaced(here, capsys):
    assert set(KINDS) == FIGURES
    assert cli.main([*RUN, "--out", "x"]) == cli.DONE
    assert cli.main(["report", "x", "--figures", "svg", "--animate"]) == cli.DONE
    assert cli.main(["report", "x", "--figures", "pdf"]) == cli.DONE
    assert len(list((here / "x" / "figures").iterdir())) > 10
    assert reason_not_a_run(here / "x") == ""
    assert cli.main([*RUN, "--seed", "7", "--out", "x", "--overwrite"]) == cli.DONE
    assert seed_of(here / "x") == 7
    assert sorted(path.name for path in here.iterdir()) == ["x"]


def test_a_campaign_is_never_replaced_by_a_run(here, capsys):
    (here / "mc" / "rows").mkdir(parents=True)
    (here / "mc" / "campaign.toml").write_text("")
    before = content(here)
    assert "mc is not a run folder, it holds no config.toml of a run" in complaint(
        (*RUN, "--out", "mc", "--overwrite"), capsys
    )
    assert content(here) == before


def test_the_second_of_two_runs_into_one_folder_is_told(here, capsys):
    with RunFolder(here / "x", Config(seed=1)) as first:
        said = complaint((*RUN, "--out", "x"), capsys)
        assert said == "--out: found another process that writes x, allowed: another folder, or wait for its end"
        assert seed_of(first.partial) == 1
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert seed_of(here / "x") == 2


def test_the_lock_of_a_killed_process_is_free(here):
    code = (
        "import os, sys; from pathlib import Path; from sixthsense.record.folder_lock import FolderLock\n"
        "lock = FolderLock(Path('x')); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert (here / ".x.lock").exists()
    with FolderLock(here / "x"), pytest.raises(FolderInUseError):
        FolderLock(Path("x"))
    assert list(here.iterdir()) == []


def test_the_second_of_two_campaigns_into_one_folder_is_told(here, capsys):
    pytest.importorskip("distributed")
    pytest.importorskip("pyarrow")
    words = ("campaign", "rectangle", "--seeds", "0:1", "--out", "c", "--task", "tour", "--max-time", "1")
    with FolderLock(here / "c"):
        assert "another process that writes c" in complaint(words, capsys)
        assert not (here / "c").exists()


def test_runs_without_out_that_start_together_get_folders_of_their_own(here, capsys):
    with FolderLock(Path("runs/rectangle-ekf-1")):
        assert cli.main([*RUN, "--estimator", "ekf"]) == cli.DONE
    assert [path.name for path in (here / "runs").iterdir()] == ["rectangle-ekf-2"]


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


def test_what_becomes_of_out_during_a_run_is_not_lost_either(here, capsys):
    ss.run("rectangle", task="tour", max_time=2.0, seed=1, out="x")

    def write_notes(*_: object) -> None:
        (here / "x" / "notes.txt").write_text("mine")

    with pytest.raises(FolderError, match=r"it holds notes.txt, which no run writes, .*; the run is in x.partial$"):
        ss.run("rectangle", write_notes, task="tour", max_time=2.0, seed=2, out="x", overwrite=True)
    assert (here / "x" / "notes.txt").read_text() == "mine" and seed_of(here / "x.partial") == 2

    def appear(*_: object) -> None:
        (here / "y").mkdir(exist_ok=True)

    with pytest.raises(FolderError, match=r"y exists, .*; the run is in y.partial$"):
        ss.run("rectangle", appear, task="tour", max_time=2.0, seed=3, out="y")
    assert tomllib.loads((here / "y.partial" / "metrics.json").with_name("config.toml").read_text())["seed"] == 3


@pytest.mark.parametrize("name", ["x", "x.partial"])
@pytest.mark.parametrize("to", ["self", "nowhere", "run"])
def test_a_folder_that_is_a_symbolic_link_is_refused_in_one_line(name, to, here, capsys):
    ss.run("rectangle", task="tour", max_time=2.0, out="run")
    (here / name).symlink_to({"self": name}.get(to, to))
    before = sorted(path.name for path in here.iterdir())
    said = complaint((*RUN, "--out", "x", "--overwrite"), capsys)
    assert "is a symbolic link" in said
    assert sorted(path.name for path in here.iterdir()) == before
    assert (here / name).is_symlink() and reason_not_a_run(here / "run") == ""


def test_a_scene_a_log_and_a_configuration_that_link_to_themselves_are_named_in_one_line(here, capsys):
    for name in ("s.toml", "m.yaml", "x.log", "x.bag", "r", "c.toml", "folder"):
        (here / name).symlink_to(name)
    (here / "good.log").write_text("FLASER 3 1 1 2 0 0 0 0 0 0 1 h 1\n")
    for line, said in {
        "run s.toml": "s.toml: cannot be read (Too many levels of symbolic links)",
        "run m.yaml": "m.yaml: cannot be read (Too many levels of symbolic links)",
        "run --config c.toml": "c.toml: cannot be read (Too many levels of symbolic links)",
        "replay x.log": "x.log",
        "replay x.bag": "x.bag",
        "replay good.log --relations r --laser.beams 3": "r",
        "report folder": "folder",
        "run rectangle --out folder/x": "--out: folder/x.partial cannot be written",
        "campaign s.toml --seeds 0:1 --out c": "s.toml",
    }.items():
        assert said in complaint(tuple(line.split()), capsys)


def test_memory_that_ends_while_a_figure_is_drawn_costs_the_figure_alone(here, capsys, monkeypatch):
    def no_memory(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr("sixthsense.figures.plot.save_map", no_memory)
        assert cli.main([*RUN, "--out", "x"]) == cli.DONE
    err = capsys.readouterr().err
    assert "note: out of memory, x has no figures/map.png; sixthsense report x draws it\n" in err
    assert reason_not_a_run(here / "x") == "" and ss.load("x").metrics["outcome"] == "tour ended"


def test_memory_that_ends_during_a_run_is_told_in_one_line_with_the_record(here, capsys, monkeypatch):
    def no_memory(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("sixthsense.record.folder.write_landmarks", no_memory)
    said = complaint((*RUN, "--out", "x"), capsys)
    assert said == "out of memory; the record so far is in x.partial"
    assert len(ss.load("x.partial").trace.estimates) > 10


def test_no_warning_is_given_where_nothing_is_moved(here):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.run("rectangle", task="tour", max_time=1.0, out="x")
        ss.run("rectangle", task="tour", max_time=1.0, out="x", overwrite=True)
    assert [path.name for path in here.iterdir()] == ["x"]
