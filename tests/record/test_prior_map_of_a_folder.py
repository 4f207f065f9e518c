"""The map that a run's folder gives to the next run, and what is refused, each by its own trigger alone."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from traces import CONFIG, trace_of, written

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import FILE
from sixthsense.record.store import prior_start, read_prior_map
from sixthsense.record.stream import RecordWriter
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate


@pytest.fixture
def trace() -> Trace:
    return trace_of(np.random.default_rng(5))


@pytest.fixture
def folder(trace: Trace) -> Iterator[Path]:
    with written(trace) as out:
        yield out


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


def without_landmarks(trace: Trace) -> None:
    trace.joint_cov, trace.records = trace.joint_cov[:3, :3], {}
    trace.final = Estimate.of_pose(trace.final.pose, trace.joint_cov)


def indefinite(trace: Trace) -> None:
    trace.joint_cov[4, 4] *= -1.0


REFUSED: dict[str, tuple[Callable[[Trace], object], str]] = {
    "no landmarks": (without_landmarks, "a map without landmarks"),
    "an unknown landmark": (lambda trace: trace.records.pop(13), "landmarks without a record"),
    "no covariance": (indefinite, "allowed: a covariance"),
    "a covariance of others": (
        lambda trace: setattr(trace, "joint_cov", trace.joint_cov[:9, :9]),
        "of other landmarks",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_map_that_is_wrong_is_refused(name: str, folder: Path, trace: Trace) -> None:
    by, said = REFUSED[name]
    by(trace)
    RecordWriter(folder / FILE).end(trace, {})
    with pytest.raises(InputError, match=said):
        read_prior_map(folder)


def test_a_folder_without_a_part_of_the_map_is_refused(folder: Path, tmp_path: Path, trace: Trace) -> None:
    shutil.copy(folder / "config.toml", tmp_path)
    record = RecordWriter(tmp_path / FILE)
    record(Tick(1, Pose()), trace)
    record.close()
    with pytest.raises(InputError, match="found a run that was stopped"):
        read_prior_map(tmp_path)
    (folder / FILE).unlink()
    with pytest.raises(InputError, match="no such file"):
        read_prior_map(folder)


@pytest.mark.parametrize(("has_map", "pose", "sigma", "lost", "said"), [
    (False, (1.0, 2.0, 3.0), None, False, "^pose: found without `prior_map`"),
    (False, None, (1.0, 2.0, 3.0), False, "^pose_sigma: found without `prior_map`"),
    (False, None, None, True, "^lost: found without `prior_map`"),
    (True, (1.0, 2.0), None, False, r"^pose: found \(1.0, 2.0\), allowed: 3 numbers"),
    (True, None, (1.0, 2.0, np.inf), False, "^pose_sigma: found inf, allowed: a finite number"),
    (True, None, (0.1, -0.2, 0.3), False, "^pose_sigma: .* allowed: at least 0"),
    (True, (1.0, 2.0, 3.0), None, True, "^pose: found with `lost`"),
    (True, None, (0.1, 0.2, 0.3), True, "^pose_sigma: found with `lost`"),
])  # fmt: skip
def test_a_start_that_says_nothing_or_contradicts_itself_is_refused(has_map, pose, sigma, lost, said, folder) -> None:
    with pytest.raises(InputError, match=said):
        prior_start(folder if has_map else None, pose, sigma, lost)
