from collections.abc import Iterator
from pathlib import Path

import pytest

from sixthsense import cli
from sixthsense.config import Config, load_config, preset
from sixthsense.config.errors import InputError
from sixthsense.evaluation.measure import measure
from sixthsense.figures.plot import save_map
from sixthsense.logs.runfolder import FILE
from sixthsense.loop.run import run
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace
from sixthsense.record.writing import LOCK, whole

CORNERS = {"landmarks": "corners"}
CONFIG = preset(scene="rectangle", task="tour", max_time=15.0, seed=5, features=CORNERS)
RUN = ("run", "rectangle", "--task", "tour", "--max-time", "2")
FILES = [
    "config.toml", "estimate.tum", "landmarks.csv", "map.pgm", "map.png", "map.yaml", "metrics.json", "record.mcap",
    "smoothed.tum", "truth.tum",
]  # fmt: skip

pytestmark = pytest.mark.usefixtures("compiled")


@pytest.fixture(scope="module")
def trace() -> Trace:
    return run(CONFIG)


@pytest.fixture(scope="module")
def out(trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A finished run's folder."""
    folder = RunFolder(tmp_path_factory.mktemp("runs") / "some", CONFIG)
    folder.write(trace, measure(trace))
    save_map(trace, folder.partial / "map.png", "a title")
    folder.finish()
    yield folder.out


def entries(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def made(out: Path, seed: int = 1) -> Path:
    """The folder of a run that has begun its record."""
    folder = RunFolder(out, Config(seed=seed))
    (folder.partial / FILE).write_text("a record")
    folder.finish()
    return out


def content(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def seed_of(folder: Path) -> int:
    return load_config(folder / "config.toml").seed


def test_a_finished_folder_holds_every_file_and_nothing_beside_it(out: Path) -> None:
    assert entries(out) == FILES
    assert [p.name for p in out.parent.iterdir()] == ["some"]


def test_a_run_with_its_exports_is_replaced_and_what_else_lies_there_is_kept_and_named(here: Path, capsys) -> None:
    out = made(here / "x")
    (out / "figures").mkdir()
    (out / "figures" / "report.html").write_text("by a report")
    (out / "graph.g2o").write_text("by an export")
    (out / "notes.txt").write_text("mine")
    (out / "more").mkdir()
    (out / "more" / "film.webp").write_text("mine")
    assert cli.main([*RUN, "--seed", "3", "--out", "x", "--overwrite"]) == cli.DONE
    assert "note: kept in x, which it replaces: more, notes.txt\n" in capsys.readouterr().err
    assert entries(out) == sorted([*FILES, "more", "more/film.webp", "notes.txt"])
    assert (out / "notes.txt").read_text() == (out / "more" / "film.webp").read_text() == "mine"
    assert seed_of(out) == 3 and [path.name for path in here.iterdir()] == ["x"]


FOREIGN = {"no configuration": None, "no version": "seed = 3\n[versions]\nsixthsense = 1\n", "no TOML": "]["}


@pytest.mark.parametrize("place", ["x", "x.partial"])
@pytest.mark.parametrize("name", FOREIGN)
def test_a_folder_of_others_is_never_taken_for_that_of_a_run(name: str, place: str, here: Path) -> None:
    (here / place).mkdir()
    (here / place / "notes.txt").write_text("mine")
    if (text := FOREIGN[name]) is not None:
        (here / place / "config.toml").write_text(text)
    before = content(here)
    with pytest.raises(InputError, match=r"^out: .* is not a run folder, it holds no config.toml of a run, allowed: "):
        RunFolder(here / "x", Config(), overwrite=True)
    assert content(here) == before


@pytest.mark.parametrize("name", ["link", "file", "no overwrite"])
def test_a_place_that_is_no_folder_of_a_run_is_refused(name: str, here: Path) -> None:
    made(here / "other")
    out = here / "x"
    if name == "file":
        out.write_text("mine")
    elif name == "link":
        out.symlink_to("other")
    else:
        made(out)
    before = content(here)
    with pytest.raises(InputError, match=r"^out: "):
        RunFolder(out, Config(), overwrite=name != "no overwrite")
    assert content(here) == before


@pytest.mark.parametrize(("error", "has_record", "is_left"), [
    (InputError("x", "bad"), False, False), (InputError("x", "bad"), True, True), (KeyboardInterrupt(), False, False),
    (RuntimeError("a bug"), False, False), (RuntimeError("a bug"), True, True),
])  # fmt: skip
def test_a_run_that_is_stopped_before_its_first_record_leaves_nothing(error, has_record, is_left, here):
    with pytest.raises(type(error)), RunFolder(here / "deep" / "x", Config()) as folder:
        (folder.partial / FILE).write_text("a record" if has_record else "")
        raise error
    partial = here / "deep" / "x.partial"
    assert partial.exists() is partial.parent.exists() is is_left and not (partial / LOCK).exists()


def test_a_folder_that_has_meanwhile_become_something_else_is_not_replaced(here: Path) -> None:
    with RunFolder(made(here / "x"), Config(seed=2), overwrite=True) as folder:
        (here / "x" / "config.toml").write_text("mine = true\n")
        with pytest.raises(InputError, match=r"holds no config.toml of a run.*; the run is in .*x.partial$"):
            folder.finish()
    assert (here / "x" / "config.toml").read_text() == "mine = true\n" and seed_of(here / "x.partial") == 2


def test_the_second_of_two_runs_into_one_folder_is_told(here, complaint):
    with RunFolder(here / "x", Config(seed=1)) as first:
        said = complaint(*RUN, "--out", "x", writes_nothing=False)
        assert said.startswith("--out: found another process that writes x.partial, allowed: another folder")
        assert seed_of(first.partial) == 1
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert seed_of(here / "x") == 2


def test_what_a_stopped_run_has_recorded_is_kept_under_another_name_and_the_user_is_told(here, capsys, caplog):
    for seed in (1, 2):
        made(here / "stopped", seed).rename(here / "x.partial")
        (here / "x.partial" / LOCK).write_text("")  # a killed process leaves it, not locked
        assert cli.main([*RUN, "--seed", "3", "--out", "x", "--overwrite"]) == cli.DONE
        said = capsys.readouterr().err
        assert f"note: x.partial of a run that did not finish is kept as x.{seed}.partial\n" in said
    assert [seed_of(here / name) for name in ("x", "x.1.partial", "x.2.partial")] == [3, 1, 2]
    caplog.clear()
    with RunFolder(here / "y", Config(seed=4)):
        pass  # killed before its first record
    with RunFolder(here / "y", Config(seed=5)) as folder:
        assert not caplog.records and seed_of(folder.partial) == 5


def test_a_file_is_there_as_a_whole_or_not_at_all_and_its_error_names_it(here: Path) -> None:
    with whole(here / "a.txt") as file:
        file.write_text("new")
        assert not (here / "a.txt").exists()
    assert (here / "a.txt").read_text() == "new"
    with pytest.raises(OSError) as told, whole(here / "a.txt") as file:
        file.write_text("half")
        raise OSError(28, "No space left on device")
    assert told.value.filename == str(here / "a.txt")
    assert (here / "a.txt").read_text() == "new" and [path.name for path in here.iterdir()] == ["a.txt"]
