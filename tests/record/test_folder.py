import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from sixthsense import cli
from sixthsense.config import Config, load_config, preset
from sixthsense.config.errors import InputError
from sixthsense.evaluation.measure import measure
from sixthsense.figures.plot import save_map
from sixthsense.loop.run import run
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace
from sixthsense.record.writing import FolderInUseError, FolderLock, whole

CORNERS = {"landmarks": "corners"}
CONFIG = preset(scene="rectangle", task="tour", max_time=15.0, seed=5, features=CORNERS)
RUN = ("run", "rectangle", "--task", "tour", "--max-time", "2")
FILES = [
    "config.toml", "estimate.tum", "figures", "figures/map.png", "graph.g2o", "graph.npz",
    "landmarks.csv", "map.pgm", "map.yaml", "metrics.json", "record.jsonl", "record.npz",
    "smoothed.tum", "truth.tum", "verdict.json",
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
    save_map(trace, folder.partial / "figures" / "map.png", "a title")
    folder.finish()
    yield folder.out


def entries(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_a_finished_folder_holds_every_file_and_nothing_beside_it(out: Path) -> None:
    assert entries(out) == sorted(FILES)
    assert [p.name for p in out.parent.iterdir()] == ["some"]


def test_until_it_is_finished_the_folder_is_called_partial_and_knows_its_configuration(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "deep" / "run", Config())
    assert entries(tmp_path) == ["deep", "deep/.run.lock", "deep/run.partial", "deep/run.partial/config.toml"]
    folder.finish()
    assert entries(tmp_path) == ["deep", "deep/run", "deep/run/config.toml"]


def test_a_failure_leaves_the_old_folder_whole(tmp_path: Path, trace: Trace) -> None:
    old = RunFolder(tmp_path / "run", Config(seed=1))
    (old.partial / "record.jsonl").write_text('{"format":2,"radius_m":0.2,"scene":null}\n')
    old.finish()
    folder = RunFolder(tmp_path / "run", Config(seed=2), overwrite=True)
    broken = dataclasses.replace(trace, stamps_ns=trace.stamps_ns[:-1])
    with pytest.raises(ValueError):
        folder.write(broken, {})
    assert entries(tmp_path / "run") == ["config.toml", "record.jsonl"]
    assert seed_of(tmp_path / "run") == 1


def test_what_is_no_run_is_not_taken_for_a_killed_one(tmp_path: Path) -> None:
    (tmp_path / "run.partial").mkdir()
    (tmp_path / "run.partial" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"is not a run folder, it holds no config.toml of a run, allowed: "):
        RunFolder(tmp_path / "run", Config(), overwrite=True)
    assert entries(tmp_path / "run.partial") == ["notes.txt"]


# --- a run replaces an earlier run, and nothing else

BEGIN = '{"format":2,"radius_m":0.2,"scene":null}\n'
WRITTEN = [
    *FILES, "truth.tum", "places_left.csv", "bag/bag_0.mcap", "bag/metadata.yaml", "figures/report.html",
    "figures/animation.gif", "figures/map.svg", "figures/error.pdf", "figures/rpe.png", "figures/nees.png",
    "figures/nis.png", "figures/stages.png", "figures/coverage.png", "figures/exploration.png",
]  # fmt: skip
"""what runs and their reports write, at most"""


def made(out: Path, seed: int = 1) -> Path:
    """The folder of a run that has begun its record."""
    folder = RunFolder(out, Config(seed=seed))
    (folder.partial / "record.jsonl").write_text(BEGIN)
    folder.finish()
    return out


def content(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def seed_of(folder: Path) -> int:
    return load_config(folder / "config.toml").seed


def test_a_folder_with_all_that_runs_and_their_reports_write_is_replaced(here: Path) -> None:
    out = made(here / "x")
    for name in {*WRITTEN} - {"config.toml", "record.jsonl", "figures"}:
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text("by a run")
    with RunFolder(out, Config(seed=2), overwrite=True) as folder:
        folder.finish()
    assert entries(out) == ["config.toml"] and seed_of(out) == 2
    assert [path.name for path in here.iterdir()] == ["x"]


FOREIGN = {
    "a file": {"notes.txt": "mine"}, "a figure": {"figures/mine.png": "mine"},
    "a figure of another form": {"figures/map.txt": "mine"}, "a figure elsewhere": {"map.png": "mine"},
    "a second bag": {"bag/bag_1.mcap": "mine"}, "a folder": {"more/": ""}, "a folder named as a file": {"map.pgm/": ""},
    "other settings": {"config.toml": "[net]\n"},
    "saved settings of no version": {"config.toml": "seed = 3\n[versions]\nsixthsense = 1\n"},
    "another record": {"record.jsonl": '{"a": 1}\n'},
}  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_what_no_run_has_written_is_never_removed(name: str, here: Path) -> None:
    out = made(here / "x")
    for file, text in FOREIGN[name].items():
        (out / file).parent.mkdir(exist_ok=True)
        (out / file).mkdir() if file.endswith("/") else (out / file).write_text(text)
    before = content(here)
    with pytest.raises(InputError, match=r"^out: .*x is not a run folder, it holds "):
        RunFolder(out, Config(), overwrite=True)
    assert content(here) == before


@pytest.mark.parametrize("name", ["link", "file", "link to the old run", "partial link", "no overwrite", "no name"])
def test_a_place_that_is_no_folder_of_a_run_is_refused(name: str, here: Path) -> None:
    made(here / "other")
    out = here / "x"
    if name == "file":
        out.write_text("mine")
    elif name == "partial link":
        (here / "x.partial").symlink_to("other")
    elif name.startswith("link"):
        out.symlink_to("other")
    elif name == "no overwrite":
        made(out)
    before = content(here)
    with pytest.raises(InputError, match=r"^out: "):
        RunFolder(Path() if name == "no name" else out, Config(), overwrite=name != "no overwrite")
    assert content(here) == before


@pytest.mark.parametrize(("error", "has_record", "is_left"), [
    (InputError("x", "bad"), False, False), (InputError("x", "bad"), True, True), (KeyboardInterrupt(), False, False),
    (RuntimeError("a bug"), False, True),
])  # fmt: skip
def test_bad_input_before_the_first_record_leaves_nothing_and_all_else_leaves_the_evidence(
    error: BaseException, has_record: bool, is_left: bool, here: Path
) -> None:
    with pytest.raises(type(error)), RunFolder(here / "x", Config()) as folder:
        (folder.partial / "record.jsonl").write_text(BEGIN if has_record else "")
        raise error
    assert (here / "x.partial").exists() is is_left and not (here / ".x.lock").exists()


def test_a_folder_that_has_meanwhile_become_something_else_is_not_replaced(here: Path) -> None:
    with RunFolder(made(here / "x"), Config(seed=2), overwrite=True) as folder:
        (here / "x" / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match=r"holds notes.txt.*; the run is in .*x.partial$"):
            folder.finish()
    assert seed_of(here / "x") == 1 and seed_of(here / "x.partial") == 2


def test_the_second_of_two_runs_into_one_folder_is_told(here, complaint):
    with RunFolder(here / "x", Config(seed=1)) as first:
        said = complaint(*RUN, "--out", "x")
        assert said == "--out: found another process that writes x, allowed: another folder, or wait for its end"
        assert seed_of(first.partial) == 1
    assert cli.main([*RUN, "--seed", "2", "--out", "x"]) == cli.DONE
    assert seed_of(here / "x") == 2


def test_what_a_killed_run_has_recorded_is_kept_under_another_name_and_the_user_is_told(here, capsys):
    for seed in (1, 2):
        made(here / "killed", seed).rename(here / "x.partial")
        assert cli.main([*RUN, "--seed", "3", "--out", "x", "--overwrite"]) == cli.DONE
        assert f"note: x.partial of a killed run is kept as x.{seed}.partial\n" in capsys.readouterr().err
    assert [seed_of(here / name) for name in ("x", "x.1.partial", "x.2.partial")] == [3, 1, 2]
    with RunFolder(here / "y", Config(seed=4)):
        pass  # killed before its first record
    with RunFolder(here / "y", Config(seed=5)) as folder:
        assert folder.notes == [] and seed_of(folder.partial) == 5


def test_an_old_run_is_restored_where_the_new_one_cannot_take_its_name(here, monkeypatch):
    rename = Path.rename

    def failing(path: Path, target: Path) -> Path:
        if path.name == "x.partial":
            raise PermissionError(13, "Permission denied")
        return rename(path, target)

    with RunFolder(made(here / "x"), Config(seed=2), overwrite=True) as folder, monkeypatch.context() as patch:
        patch.setattr(Path, "rename", failing)
        with pytest.raises(PermissionError):
            folder.finish()
    assert (seed_of(here / "x"), seed_of(here / "x.partial")) == (1, 2)
    assert sorted(path.name for path in here.iterdir()) == ["x", "x.partial"]


@pytest.mark.parametrize("new_has_its_name", [False, True])
def test_a_replacement_that_was_killed_is_completed_by_the_next_run(new_has_its_name, here):
    for name, seed in (("x" if new_has_its_name else "x.partial", 2), (".x.replaced", 1)):
        made(here / name, seed)
    if new_has_its_name:
        (here / ".x.replaced" / "config.toml").unlink()  # half removed
    folder = RunFolder(here / "x", Config(seed=3), overwrite=True)
    assert seed_of(here / "x") == (2 if new_has_its_name else 1)
    assert len(folder.notes) == (0 if new_has_its_name else 2)
    assert not (here / ".x.replaced").exists()
    assert (here / "x.1.partial").exists() is not new_has_its_name


def test_a_replacement_is_not_completed_over_what_someone_has_written_there(here: Path) -> None:
    made(here / "x")
    made(here / ".x.replaced", 2)
    (here / ".x.replaced" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds notes.txt, which no run writes, allowed: move it away"):
        RunFolder(here / "x", Config(), overwrite=True)
    assert (here / ".x.replaced" / "notes.txt").exists()


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


def test_a_lock_leaves_no_folder_in_which_nothing_was_written(here: Path) -> None:
    with FolderLock(here / "deep" / "run"):
        with pytest.raises(FolderInUseError):
            FolderLock(here / "deep" / "run")
        assert entries(here) == ["deep", "deep/.run.lock"]
    assert entries(here) == []
