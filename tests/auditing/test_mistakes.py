"""The usual mistakes are named by their own numbers, and what can be right is not."""

import numpy as np
import pandas as pd
import pytest

import sixthsense as ss
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


def test_the_exactly_known_pose_at_which_a_map_begins_is_no_fault_and_a_later_one_is():
    covs = np.array(np.broadcast_to(COV, (N, 3, 3)))
    covs[0] = 0.0
    assert notes(covs) == []
    covs[7] = 0.0
    assert notes(covs) == ["cannot be right: 1 of 300 covariances are not positive definite: their poses are left out"]


COVS = np.broadcast_to(COV, (N, 3, 3))


def heard(estimate=TRUTH + ERROR, covs=COVS, truth=TRUTH, stamps=STAMPS, at=STAMPS):
    """The refusal of an audit, or its notes."""
    try:
        return "; ".join(ss.audit((stamps, estimate, covs), (at, truth)).notes)
    except InputError as error:
        return str(error)


DEGREES = np.array([1.0, 1.0, 180.0 / np.pi])
EPOCH_NS = np.round(1e9 * (STAMPS + 1.7e9)).astype(np.int64)
TURNING = np.column_stack([TRUTH[:, :2], np.unwrap(HEADING)])
ALONG = np.column_stack([TRUTH[:, :2], np.unwrap(HEADING) + 0.025])  # the way goes along the heading

ASIDE = TURNING + np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(("given", "said"), [
    ({"estimate": (TRUTH + ERROR) * DEGREES}, "found headings of odometry, along which"),
    ({"estimate": (ALONG + ERROR * 0.01) * DEGREES}, "robot goes only if they are degrees"),
    ({"estimate": (TURNING + ERROR) * DEGREES, "truth": TURNING * DEGREES}, "headings"),
    ({"estimate": (ASIDE + ERROR) * DEGREES, "truth": ASIDE}, "cannot be right: headings of estimate do not turn as"),
    ({"covs": np.broadcast_to(COV * np.outer(DEGREES, DEGREES), (N, 3, 3))}, "are the variances in degrees²?"),
    ({"covs": np.broadcast_to(np.diag(np.sqrt(np.diag(COV))), (N, 3, 3))}, "are these sigmas in place of variances?"),
    ({"estimate": (TRUTH + ERROR)[:, [1, 0, 2]]}, "fit the truth as y, x, theta, not as x, y, theta"),
    ({"estimate": (TURNING + ERROR)[:, [2, 0, 1]], "truth": TURNING}, "fit the truth as theta, x, y, not"),
    ({"estimate": (TURNING + ERROR)[:, [1, 2, 0]], "truth": TURNING}, "fit the truth as y, theta, x, not"),
    ({"stamps": np.array([float(f"{t:.6g}") for t in STAMPS + 1.7e9]), "at": STAMPS + 1.7e9}, "not rounded as by %.6g"),
    ({"stamps": np.where(np.arange(N) == 150, STAMPS[149], STAMPS)}, "1 poses have the stamp of another one"),
    ({"at": STAMPS + 1000.0}, "or `same_start` if both begin together"),
    ({"stamps": EPOCH_NS, "at": EPOCH_NS}, "are taken as nanoseconds"),
    ({"stamps": pd.to_datetime([None] * N), "at": STAMPS}, "found one that is no time (NaT)"),
    ({"stamps": (t for t in STAMPS)}, "estimate stamps: expected numbers of shape (N,)"),
    ({"stamps": TRUTH, "estimate": STAMPS}, "estimate stamps: expected shape (N,), got (300, 3)"),
])  # fmt: skip
def test_a_mistake_is_named_in_one_line(given, said):
    heard_now = heard(**given)
    assert said in heard_now and "\n" not in heard_now and heard_now.count("cannot be right") <= 1


@pytest.mark.parametrize("of", [
    lambda t: pd.to_datetime(t + 1.7e9, unit="s"), lambda t: pd.to_datetime(t + 1.7e9, unit="s").to_numpy(),
    lambda t: pd.to_datetime(t + 1.7e9, unit="s", utc=True), lambda t: pd.to_timedelta(t, unit="s").to_numpy(),
    lambda t: np.round(1e9 * (t + 1.7e9)).astype(np.int64), lambda t: np.round(1e3 * (t + 1.7e9)),
])  # fmt: skip
def test_times_and_durations_are_stamps(of):
    plain = ss.audit((STAMPS, TRUTH + ERROR, np.broadcast_to(COV, (N, 3, 3))), (STAMPS, TRUTH))
    found = ss.audit((of(STAMPS), TRUTH + ERROR, np.broadcast_to(COV, (N, 3, 3))), (of(STAMPS), TRUTH))
    np.testing.assert_allclose(np.diff(found.runs[0].stamps_ns), np.diff(plain.runs[0].stamps_ns), atol=1000)
    assert found.findings.pose.nees == pytest.approx(plain.findings.pose.nees)


def test_what_is_right_is_not_named_as_a_mistake():
    assert heard() == ""
    assert heard(estimate=TURNING + ERROR) == "" == heard(estimate=ALONG + ERROR, truth=ALONG)
    assert heard(covs=np.broadcast_to(4.0 * COV, (N, 3, 3))) == "" == heard(covs=np.broadcast_to(COV / 9.0, (N, 3, 3)))
    assert heard(stamps=np.repeat(STAMPS, 2), estimate=np.repeat(TRUTH + ERROR, 2, axis=0),
                 covs=np.broadcast_to(COV, (2 * N, 3, 3))) == ""  # fmt: skip


def test_a_consistent_estimate_beside_a_truth_every_four_seconds_along_a_curve_is_not_called_overconfident():
    t = 0.1 * np.arange(6000)
    truth = np.column_stack([4.0 * np.sin(0.3 * t), -4.0 * np.cos(0.3 * t), 0.3 * t])
    error = np.random.default_rng(7).multivariate_normal(np.zeros(3), COV, len(t))
    estimate = (t, truth + error, np.broadcast_to(COV, (len(t), 3, 3)))
    found = ss.audit(estimate, (t[::40], truth[::40]))
    assert found.outcome == "consistent" and found.findings.poses == 150
    assert any("the truth bends by 0.64 m between its poses, every 4 s" in note for note in found.notes)
    dense = ss.audit(estimate, (t[::2], truth[::2]))
    assert dense.findings.poses == 5999 and dense.outcome == "consistent" and "bends" not in str(dense)
    shifted = ss.audit(estimate, (t[::2] + 1e4, truth[::2]), same_start=True)
    assert shifted.findings.pose == dense.findings.pose


def shown_by(estimate, truth, stamps_s=None):
    """The notes on 240 s of a drive with white errors as stated, where estimate or truth is as given."""
    rng = np.random.default_rng(4)
    cov = np.diag([0.04, 0.05, 0.01]) ** 2
    t = 0.2 * np.arange(1200.0)
    way = np.column_stack([5.0 * np.sin(0.11 * t), 3.0 * np.cos(0.23 * t), 1.5 * np.sin(0.31 * t) + 0.02 * t])
    drawn = way + rng.multivariate_normal(np.zeros(3), cov, len(t))
    found = ss.audit(
        (t, estimate(drawn, t), np.broadcast_to(cov, (len(t), 3, 3))),
        (t if stamps_s is None else stamps_s(t), truth(way, t)),
    )
    return [note for note in found.notes if not note.startswith("left out")]


def same(way, _):
    return way


def moved(way, _):
    c, s = np.cos(1.7), np.sin(1.7)
    return np.column_stack([c * way[:, 0] - s * way[:, 1] + 3.0, s * way[:, 0] + c * way[:, 1] - 2.0, way[:, 2] + 1.7])


def another(_, t):
    return np.column_stack([4.0 * np.cos(0.17 * t), 5.0 * np.sin(0.07 * t), 1.3 * np.cos(0.19 * t) - 0.05 * t])


@pytest.mark.parametrize(("estimate", "truth", "stamps_s", "said"), [
    (same, another, None, "estimate and truth may not be of one drive, or have other clocks: their turns correlate by"),
    (same, moved, None, "the frames differ: aligned by all poses (`align` all) the ATE falls from"),
    (same, lambda way, _: way * (1000.0, 1000.0, 1.0), None, "times those of estimate: are both in metres?"),
    (same, lambda way, _: way + np.array([0.0, 0.0, 0.5 * np.pi]), None, "headings differ by -90° all along"),
    (same, same, lambda t: t + 0.5, "stamps of the estimate are about 0.5 s early, by the errors of headings"),
    (same, same, lambda t: t - 0.5, "stamps of the estimate are about 0.5 s late, by the errors of headings"),
])  # fmt: skip
def test_errors_that_are_no_estimators_are_told_by_what_they_look_like(estimate, truth, stamps_s, said):
    notes = shown_by(estimate, truth, stamps_s)
    assert len(notes) <= 2 and any(said in note for note in notes)


def test_honest_errors_drift_and_overconfidence_are_not_told_as_another_cause():
    assert shown_by(same, same) == []
    assert shown_by(lambda way, _: 3.0 * (way - way.mean(axis=0)) - 2.0 * way + way.mean(axis=0) * 3.0, same) == []
    rng = np.random.default_rng(6)
    assert shown_by(lambda way, _: way + np.cumsum(rng.normal(0.0, (0.02, 0.02, 0.002), way.shape), axis=0), same) == []
