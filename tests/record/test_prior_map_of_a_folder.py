"""The map that a run's folder gives to the next run, and what is refused, each by its own trigger alone."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from traces import CONFIG, trace_of, written

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.record.store import END_FILE, load_record, prior_start, read_prior_map
from sixthsense.record.trace import Trace

Arrays = dict[str, np.ndarray]


@pytest.fixture
def trace() -> Trace:
    return trace_of(np.random.default_rng(5))


@pytest.fixture
def folder(trace: Trace) -> Iterator[Path]:
    with written(trace) as out:
        yield out


def change(file: Path, by: Callable[[Arrays], object]) -> None:
    with np.load(file) as content:
        arrays = dict(content)
    by(arrays)
    np.savez(file, **arrays)


def test_the_map_of_a_folder_has_its_landmarks_their_covariance_records_and_cells(folder: Path, trace: Trace) -> None:
    prior, grid = read_prior_map(folder), trace.grid
    assert (prior.name, prior.cell_m) == ("run", CONFIG.grid.cell_m) and grid is not None
    landmarks, ids = prior.landmarks, trace.final.ids.tolist()
    assert landmarks.ids.tolist() == ids == list(prior.records)
    assert np.array_equal(landmarks.landmarks, trace.final.landmarks)
    assert np.array_equal(landmarks.walls, trace.final.walls)
    assert np.array_equal(landmarks.cov, trace.joint_cov[3:, 3:])
    assert np.array_equal(landmarks.extents, [trace.records[i].extent for i in ids])
    expected = grid.submap()
    for name in ("cells", "hits", "passes", "seen"):
        assert np.array_equal(getattr(prior.evidence, name), getattr(expected, name)), name


def test_the_digest_of_a_map_changes_with_each_of_its_arrays_and_with_nothing_else(folder: Path) -> None:
    digests = [read_prior_map(folder).digest]
    change(folder / END_FILE, lambda arrays: arrays.update(trajectory=arrays["trajectory"] + 1))
    assert read_prior_map(folder).digest == digests[0]
    for array in ("mean", "sigmas_m", "hits"):
        change(folder / END_FILE, lambda arrays, array=array: arrays.update({array: arrays[array] + 1}))  # type: ignore[misc]
        digests.append(read_prior_map(folder).digest)
    assert len(set(digests)) == 4


def emptied(arrays: Arrays) -> None:
    arrays.update(ids=arrays["ids"][:0], walls=arrays["walls"][:0], mean=arrays["mean"][:3])
    arrays["covariance"] = arrays["covariance"][:3, :3]


def indefinite(arrays: Arrays) -> None:
    arrays["covariance"][4, 4] *= -1.0


REFUSED = {
    "no landmarks": (emptied, "a map without landmarks"),
    "a landmark twice": (lambda a: a["ids"].__setitem__(1, a["ids"][0]), "a landmark twice"),
    "an unknown landmark": (lambda a: a["ids"].__setitem__(1, 99), "landmarks that are in no record"),
    "no covariance": (indefinite, "allowed: a covariance"),
    "another number of rows": (lambda a: a.update(mean=a["mean"][:-2], ids=a["ids"][1:], walls=a["walls"][1:]),
                               "covariance of shape"),
    "a number missing": (lambda a: a.update(mean=a["mean"][:-1]), "mean of shape"),
    "no finite number": (lambda a: a["origin"].__setitem__(0, np.nan), "origin of shape"),
    "another type": (lambda a: a.update(hits=a["hits"].astype(float)), "hits of shape"),
    "two sizes of a map": (lambda a: a.update(seen=a["seen"][1:]), "seen of shape"),
    "no array": (lambda a: a.pop("extents"), "found extents"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_map_that_is_damaged_is_refused_and_its_file_named(name: str, folder: Path) -> None:
    by, said = REFUSED[name]
    read_prior_map(folder)
    change(folder / END_FILE, by)
    with pytest.raises(InputError, match=said) as told:
        read_prior_map(folder)
    assert name == "no landmarks" or END_FILE in str(told.value)


def test_links_to_keyframes_that_are_not_there_are_refused(folder: Path) -> None:
    change(folder / END_FILE, lambda arrays: arrays["link_ends"].__setitem__((0, 1), 4))
    with pytest.raises(InputError, match=r"record\.npz: found link_ends to 4 of 4 keyframes"):
        load_record(folder)


def test_landmarks_of_another_run_are_refused(folder: Path) -> None:
    change(folder / END_FILE, lambda arrays: arrays["ids"].__setitem__(1, 99))
    with pytest.raises(InputError, match=r"record\.npz: found landmarks that are in no record of them"):
        load_record(folder)


@pytest.mark.parametrize("file", ["config.toml", "record.npz"])
def test_a_folder_without_a_part_of_the_map_is_refused(file: str, folder: Path) -> None:
    (folder / file).unlink()
    with pytest.raises(InputError, match=f"found no {file}"):
        read_prior_map(folder)
    shutil.rmtree(folder)
    with pytest.raises(InputError, match="no such folder"):
        read_prior_map(folder)


def test_a_folder_without_a_grid_has_landmarks_alone(folder: Path) -> None:
    change(folder / END_FILE, lambda arrays: arrays.pop("hits"))
    assert len(read_prior_map(folder).evidence.cells) == 0


def test_a_start_in_a_map_has_its_pose_and_sigmas_and_is_noted(folder: Path) -> None:
    start = prior_start(folder, (1.5, -2.5, 0.7), (0.3, 0.2, 0.1))
    assert start is not None and (start.pose, start.sigma) == (Pose(1.5, -2.5, 0.7), (0.3, 0.2, 0.1))
    assert not start.is_lost and start.note()["pose"] == [1.5, -2.5, 0.7]
    plain, lost = prior_start(folder, None, None), prior_start(folder, None, None, lost=True)
    assert plain is not None and (plain.pose, plain.sigma, plain.is_lost) == (None, (0.0, 0.0, 0.0), False)
    assert lost is not None and lost.is_lost and lost.note()["lost"] is True
    assert prior_start(None, None, None) is None


@pytest.mark.parametrize(("has_map", "pose", "sigma", "lost", "said"), [
    (False, (1.0, 2.0, 3.0), None, False, "^pose: found without `prior_map`"),
    (False, None, (1.0, 2.0, 3.0), False, "^pose_sigma: found without `prior_map`"),
    (False, None, None, True, "^lost: found without `prior_map`"),
    (True, (1.0, 2.0), None, False, "^pose: found 1.0 2.0, allowed: three finite numbers"),
    (True, None, (1.0, 2.0, np.inf), False, "^pose_sigma: .* allowed: three finite numbers"),
    (True, None, (0.1, -0.2, 0.3), False, "^pose_sigma: .* allowed: at least 0"),
    (True, (1.0, 2.0, 3.0), None, True, "^pose: found with `lost`"),
    (True, None, (0.1, 0.2, 0.3), True, "^pose_sigma: found with `lost`"),
])  # fmt: skip
def test_a_start_that_says_nothing_or_contradicts_itself_is_refused(has_map, pose, sigma, lost, said, folder) -> None:
    with pytest.raises(InputError, match=said):
        prior_start(folder if has_map else None, pose, sigma, lost)
