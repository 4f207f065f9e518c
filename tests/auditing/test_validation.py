"""What cannot be right is told before any verdict, and what can is not."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.config.errors import InputError

N = 300
STAMPS = 0.1 * np.arange(N) + 7.0
HEADING = (0.05 * np.arange(N) + 0.4 + np.pi) % (2.0 * np.pi) - np.pi
TRUTH = np.column_stack([4.0 * np.sin(HEADING), 2.0 - 4.0 * np.cos(HEADING), HEADING])
COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4
ERROR = np.random.default_rng(2).multivariate_normal(np.zeros(3), COV, N)


def notes(covs, poses=TRUTH + ERROR, **options):
    found = ss.audit((STAMPS, poses, covs), (STAMPS, TRUTH), **options).notes
    return [note for note in found if note.startswith("cannot be right")]


def spatial(order):
    covs = np.zeros((N, 6, 6))
    rows = {"translation": (0, 1, 5), "rotation": (3, 4, 2)}[order]
    covs[np.ix_(range(N), rows, rows)] = COV
    half = 0.5 * (TRUTH + ERROR)[:, 2]
    zero = np.zeros(N)
    poses = np.column_stack([(TRUTH + ERROR)[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])
    return poses, covs


def test_good_covariances_have_no_fault():
    assert notes(np.broadcast_to(COV, (N, 3, 3))) == []
    poses, covs = spatial("translation")
    assert notes(covs, poses) == []
    poses, covs = spatial("rotation")
    assert notes(covs, poses, order="rotation") == []


def test_a_heading_less_certain_than_an_unknown_one_is_told_at_the_value_where_it_begins():
    scale = np.diag([1.0, 1.0, 180.0 / np.pi])
    (note,) = notes(np.broadcast_to(np.diag([0.1, 0.1, 1.82]) ** 2, (N, 3, 3)))
    assert "300 of 300" in note and "in degrees" in note
    assert notes(np.broadcast_to(np.diag([0.1, 0.1, 1.81]) ** 2, (N, 3, 3))) == []
    assert len(notes(np.broadcast_to(scale @ (25.0 * COV) @ scale, (N, 3, 3)))) == 1


def test_a_robot_on_a_floor_with_the_rotation_first_is_told():
    poses, covs = spatial("rotation")
    with pytest.raises(InputError):  # x and y have no variance at all
        ss.audit((STAMPS, poses, covs), (STAMPS, TRUTH))


def test_covariances_without_full_rank_are_counted():
    covs = np.array(np.broadcast_to(COV, (N, 3, 3)))
    covs[11:18] = np.diag([0.01, 0.0, 0.02])
    (note,) = notes(covs)
    assert note == "cannot be right: 7 of 300 covariances are not positive definite: their poses are left out"


def test_the_exactly_known_pose_at_which_a_map_begins_is_no_fault_and_a_later_one_is():
    covs = np.array(np.broadcast_to(COV, (N, 3, 3)))
    covs[0] = 0.0
    assert notes(covs) == []
    covs[7] = 0.0
    assert notes(covs) == ["cannot be right: 1 of 300 covariances are not positive definite: their poses are left out"]


def test_headings_in_degrees_are_refused_and_those_that_go_on_are_not():
    covs = np.broadcast_to(COV, (N, 3, 3))
    poses = (TRUTH + ERROR) * [1.0, 1.0, 180.0 / np.pi]
    with pytest.raises(InputError, match=r"found headings in degrees: they jump by 3.. where they wrap, 2 times"):
        notes(covs, poses)
    unwrapped = np.column_stack([TRUTH[:, :2], np.unwrap(HEADING)]) + ERROR
    assert notes(covs, unwrapped) == []


def test_the_command_validates_without_a_truth(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    poses, covs = spatial("rotation")
    rows = np.triu_indices(6)
    np.savetxt("a.tum", np.column_stack([STAMPS, poses]))
    np.savetxt("a.cov", np.column_stack([STAMPS, covs[:, *rows]]))
    line = "audit a.tum --covariance a.cov --validate"
    assert main(line.split()) == 1
    assert "only the variances of z, roll, pitch are stated" in capsys.readouterr().out
    assert main([*line.split(), "--order", "rotation"]) == 0
    assert "a.tum: nothing found that cannot be right" in capsys.readouterr().out
