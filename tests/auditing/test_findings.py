"""The figures of an audit from a second source, when its verdict flips, and what it refuses."""

import dataclasses
import math

import numpy as np
import pytest
from auditing.test_laws import Drawn, drawn, squared
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.auditing.pairing import Errors
from sixthsense.auditing.poses import turned
from sixthsense.auditing.statistics import Findings, heading_dependence, is_other_frame
from sixthsense.evaluation.consistency import (
    Consistency,
    effective_number,
    effective_samples_of_errors,
    whitened_errors,
)


def series(seed, count, scale):
    """A planar run with general covariances, and errors that last for some poses and are as large as `scale` says."""
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(0.05, 0.7, count)) + 17.3
    truth = np.column_stack([4.0 + np.sin(0.3 * at), 0.8 * at, np.angle(np.exp(1j * (0.4 * at + 1.0)))])
    root = np.diag([0.08, 0.03, 0.05]) @ (np.eye(3) + rng.uniform(-0.4, 0.4, (count, 3, 3)))
    white = rng.standard_t(4, (count, 3))
    for k in range(1, count):
        white[k] = 0.7 * white[k - 1] + 0.7 * white[k]
    return Drawn(at, truth, truth + scale * (root @ white[:, :, None])[:, :, 0], root @ root.transpose(0, 2, 1))


RUNS = [series(1, 260, 1.3), series(2, 170, 0.9)]


def audited(align):
    return ss.audit([(one.stamps, one.estimate, one.covs) for one in RUNS], [(one.stamps, one.truth) for one in RUNS],
                    align=align, frame="body")  # fmt: skip


def interval(value, samples, dof):
    freedom = samples * dof
    return (value * freedom / chi2.ppf(0.975, freedom), value * freedom / chi2.ppf(0.025, freedom))


def worth(values, samples, dof):
    """Fewer than the correlation leaves where the squares scatter more than chi-square."""
    together = np.concatenate(values)
    return max(1.0, min(1.0, 2.0 * together.mean() ** 2 / dof / together.var()) * samples)


@pytest.mark.parametrize("align", ["none", "all"])
def test_every_number_of_the_findings_is_that_of_a_few_lines(align):
    audit = audited(align)
    found, runs = audit.findings, audit.runs
    white = [whitened_errors(run.error, run.cov) for run in runs]
    nees = [np.array([squared(*pair) for pair in zip(run.error, run.cov, strict=True)]) for run in runs]
    lengths, together = [len(run.error) for run in runs], np.concatenate(nees)
    removed = 0.0
    if align == "all":
        samples = [effective_samples_of_errors([one])[1] for one in white]
        removed = min(0.5, sum(length / own for length, own in zip(lengths, samples, strict=True)) / sum(lengths))
    mean, samples = together.mean() / (1.0 - removed), worth(nees, effective_number(nees, white), 3)
    assert (found.pose.dof, found.poses) == (3, sum(lengths)) and samples < 0.6 * found.poses
    told = (found.pose.nees, found.pose.samples, found.removed, found.factor)
    expected = (mean, samples, removed, mean / 3.0)
    assert told == pytest.approx(expected)
    assert found.pose.interval == pytest.approx(interval(mean / 3.0, samples, 3))
    for k, name in enumerate(("forward", "left", "heading")):
        ones = []
        for run in runs:
            turned = run.error.copy()
            back = run.turns.inv().as_matrix()[:, :2, :2]
            turned[:, :2] = (back @ run.error[:, :2, None])[:, :, 0]
            cov = run.cov.copy()
            cov[:, :2, :2] = back @ cov[:, :2, :2] @ back.transpose(0, 2, 1)
            ones.append((turned[:, k] / np.sqrt(cov[:, k, k]))[:, None])
        squares, one = [own[:, 0] ** 2 for own in ones], found.axes[name]
        value = np.concatenate(squares).mean() / (1.0 - removed)
        samples = worth(squares, effective_number(squares, ones), 1)
        assert (one.factor, one.samples) == pytest.approx((value, samples))
        assert one.interval == pytest.approx(interval(value, samples, 1))


def found_with(nees, samples, ratios=(1.0, 1.0, 1.0)):
    axes = {name: Consistency(ratio, 60.0, 1) for name, ratio in zip(("x", "y", "heading"), ratios, strict=True)}
    return Findings(400, Consistency(nees, samples), axes, 0.0, {0.5: 0.4, 0.9: 0.8, 0.95: 0.9})


def arrays(one):
    return (one.stamps, one.estimate, one.covs), (one.stamps, one.truth)


@pytest.mark.parametrize(("found", "ending"), [
    (found_with(6.0, 60.0, (6.0, 0.9, 1.3)), "times the stated sigmas, mostly in x"),
    (found_with(6.0, 60.0, (2.0, 1.0, 2.0)), "times the stated sigmas, in x and heading"),
    (found_with(6.0, 60.0, (2.0, 2.0, 2.0)), "times the stated sigmas, on all axes"),
    (found_with(1.5, 60.0, (0.2, 0.9, 0.9)), "times the stated sigmas, mostly in x"),
    (found_with(3.0, 60.0, (1.0, 2.2, 1.0)), "times the stated sigmas; yet not in y"),
    (found_with(3.0, 60.0, (1.0, 1.5, 1.0)), "times the stated sigmas"),
    (found_with(4.0, 12.0), "independent samples, 30 are needed"),
    (found_with(16.5, 12.0), "look for an error that stays, such as another frame, clock or mount"),
])  # fmt: skip
def test_the_verdict_is_the_sentence_on_the_pose_and_the_axes_or_the_reason(found, ending):
    audit = dataclasses.replace(ss.audit(*arrays(drawn(3, 2))), findings=found)
    assert audit.verdict.startswith(str(found.pose)) and audit.verdict.endswith(ending)


def test_the_report_and_the_table_have_the_numbers_of_the_findings(tmp_path):
    audit = audited("all")
    one, lines = audit.findings, dict(line.split(maxsplit=1) for line in repr(audit).splitlines())
    ratios = [(math.sqrt(a.factor), *a.sigmas) for a in one.axes.values()]
    ratios = [f"{n} {v:.2f} ({low:.2f} to {high:.2f})" for n, (v, low, high) in zip(one.axes, ratios, strict=True)]
    assert lines["by"] == "axis      errors over stated sigmas: " + ", ".join(ratios)
    low, high = one.pose.interval
    assert lines["factor"] == f"{one.factor:.2f} for the covariance, {low:.2f} to {high:.2f} with 95 %"
    assert lines["alignment"] == f"by all poses; {100.0 * one.removed:.2g} % of the errors' squares taken off"
    table = audit.frame()
    assert table.index.tolist() == ["pose", *one.axes] and table.loc["pose", "nees"] == one.pose.nees
    assert table.loc["left", ["factor_low", "factor_high"]].tolist() == list(one.axes["left"].interval)
    lost = dataclasses.replace(audit, findings=dataclasses.replace(one, removed=math.nan)).as_dict()["findings"]
    assert lost["removed"] is None and lost["interval"] == list(one.pose.interval)
    audit.save(tmp_path / "audit.html")
    text = (tmp_path / "audit.html").read_text(encoding="utf-8")
    assert text.index(audit.verdict) < text.index("What it rests on") < text.index("<img") < text.index("<table")


def changed(**changes):
    """A planar run that can be audited, but for what is changed."""
    parts = dataclasses.asdict(GOOD) | {"at": GOOD.stamps} | changes
    return (parts["stamps"], parts["estimate"], parts["covs"]), (parts["at"], parts["truth"])


GOOD, SPACE = drawn(5, 2), drawn(5, 3)


def spoilt(row, column, value):
    covs = GOOD.covs.copy()
    covs[4, row, column] = value
    return covs


REFUSED = [
    (changed(estimate=GOOD.truth), {}, "truth: found the poses of the estimate"),
    (changed(covs=0.0 * GOOD.covs), {}, "found covariances that are all zero"),
    (changed(covs=spoilt(0, 1, 0.4)), {}, "in the covariance at"),
    (changed(covs=spoilt(2, 2, math.nan)), {}, "in the covariance at"),
    (changed(covs=SPACE.covs), {}, "found 6 x 6 of planar poses, allowed: 3 x 3"),
    (changed(covs=GOOD.covs * np.array([1.0, 1.0, 0.0]) * np.array([[1.0], [1.0], [0.0]])), {}, "has full rank"),
    (changed(at=GOOD.stamps + 100.0), {}, "times that overlap"),
    (changed(at=GOOD.stamps[:1], truth=GOOD.truth[:1]), {}, "times that overlap"),
    (changed(), {"frame": "robot"}, "frame: found 'robot'"),
    (([arrays(GOOD)[0], arrays(SPACE)[0]], [arrays(GOOD)[1], arrays(SPACE)[1]]), {}, "allowed: all in one of them"),
    (([arrays(GOOD)[0]] * 3, [arrays(GOOD)[1]] * 2), {}, "truth: found 2 for 3 estimates"),
    ((".", arrays(GOOD)[1]), {}, "found a folder, allowed: a ROS bag"),
    (changed(estimate=np.ones((7, 5))), {}, "estimate poses: expected"),
    (([], []), {}, "estimate: found none"),
    ((arrays(GOOD)[0], None), {}, "truth: found nothing"),
]


@pytest.mark.parametrize(("given", "options", "complaint"), REFUSED, ids=[row[2] for row in REFUSED])
def test_an_audit_refuses(given, options, complaint):
    with pytest.raises(ss.InputError) as refusal:
        ss.audit(*given, **options)
    assert complaint in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_time_offset_is_added_to_the_stamps_of_the_estimate():
    at = np.linspace(3.0, 43.0, 300)
    truth = np.column_stack([3.0 * np.sin(0.4 * at), 2.0 * np.cos(0.3 * at), np.sin(0.2 * at)])
    covs = np.tile(np.diag([2e-4, 3e-4, 1e-4]), (300, 1, 1))
    found = ss.audit((at + 0.25, truth + 1e-3, covs), (at, truth), time_offset=-0.25)
    assert found.runs[0].error == pytest.approx(np.full((300, 3), 1e-3), abs=1e-6)


def test_poses_before_the_truth_in_its_gaps_and_without_rank_are_left_out_and_counted():
    at = np.arange(2.0, 22.0)
    keep = ~np.isin(at, [8.0, 9.0, 10.0, 15.0, 16.0])  # gaps of 4 and 3 s; 3 median intervals are bridged
    truth = np.column_stack([at, 0.3 * at, 0.02 * at])
    times = np.concatenate([[1.4, 1.7], at[keep], [7.5, 9.5, 15.5, 22.0]])
    estimate = np.column_stack([times + 0.1, 0.3 * times, 0.02 * times + 0.1])
    covs = np.tile(np.diag([0.02, 0.03, 0.01]), (len(times), 1, 1))
    covs[5, 1, 1] = 0.0
    found = ss.audit((times, estimate, covs), (at[keep], truth[keep]))
    lines = [note for note in found.notes if note.startswith("left out")]
    assert [line.split(" poses ")[0] for line in lines] == [f"left out: {n} of {len(times)}" for n in (3, 2, 1)]
    assert found.findings.poses == len(times) - 6


def nearly_round(rng, count=300, runs=4):
    """Honest errors of runs whose covariances are nearly round, with covariances that the heading turns beside them."""
    own, others = [], []
    for _ in range(runs):
        turns = Rotation.from_rotvec(np.column_stack([np.zeros((count, 2)), rng.uniform(-np.pi, np.pi, count)]))
        cov = np.broadcast_to(np.diag([1.1, 1.0, 1.0]), (count, 3, 3))
        error = rng.standard_normal((count, 3)) * np.sqrt([1.1, 1.0, 1.0])
        for found, covs in ((own, cov), (others, turned(cov, turns))):
            found.append(Errors(np.arange(count), error, covs, turns))
    return own, others


def test_a_heading_that_the_nees_does_not_follow_is_chi_square_and_seldom_taken_for_another_frame():
    rng = np.random.default_rng(5)
    drawn_runs = [nearly_round(rng) for _ in range(500)]
    dependence = np.array([[heading_dependence(one) for one in own] for own, _ in drawn_runs])
    # 2000 values of variance 4 have a standard error of 0.045; effective samples are at most as many as there are.
    assert 1.5 < dependence.mean() < 2.1
    # Beyond 95 % of 8 degrees of freedom, and only where the other reading fits better and follows the heading less.
    assert np.mean([is_other_frame(own, others) for own, others in drawn_runs]) < 0.008
