"""The figures of an audit from a second source, when its verdict flips, and what it refuses."""

import dataclasses
import math

import numpy as np
import pytest
from auditing.test_laws import Drawn, drawn, squared
from scipy.stats import chi2

import sixthsense as ss
from sixthsense.auditing.pairing import Errors
from sixthsense.auditing.statistics import Factor, Findings, is_other_frame
from sixthsense.evaluation.effective import effective_number, effective_samples_of_errors, whitened_errors


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


def worth(values, samples, dof, shared):
    """Fewer than the correlation leaves where the squares scatter more than chi-square, or hang on the first pose."""
    together = np.concatenate(values)
    heavy = min(1.0, 2.0 * together.mean() ** 2 / dof / together.var())
    return 1.0 / (1.0 / max(1.0, heavy * samples) + shared)


@pytest.mark.parametrize("align", ["none", "first", "all"])
def test_every_number_of_the_findings_is_that_of_a_few_lines(align):
    audit = audited(align)
    found, runs = audit.findings, audit.runs
    white = [whitened_errors(run.error, run.cov) for run in runs]
    nees = [np.array([squared(*pair) for pair in zip(run.error, run.cov, strict=True)]) for run in runs]
    lengths, together = [len(run.error) for run in runs], np.concatenate(nees)
    removed = shared = 0.0
    if align == "all":
        samples = [effective_samples_of_errors([one])[1] for one in white]
        removed = min(0.5, sum(length / own for length, own in zip(lengths, samples, strict=True)) / sum(lengths))
    if align == "first":
        shared = sum((length / sum(lengths)) ** 2 * run.shared for length, run in zip(lengths, runs, strict=True))
        assert shared > 0.01
    mean, samples = together.mean() / (1.0 - removed), worth(nees, effective_number(nees, white), 3, shared)
    assert (found.dof, found.poses) == (3, sum(lengths)) and samples < 0.6 * found.poses
    told = (found.nees, found.samples, found.removed, found.shared, found.factor.value, found.inside)
    expected = (mean, samples, removed, shared, mean / 3.0, np.mean(together < chi2.ppf(0.95, 3)))
    assert told == pytest.approx(expected)
    assert found.band == pytest.approx(chi2.ppf((0.025, 0.975), 3 * samples) / samples)
    assert found.factor.interval == pytest.approx(interval(mean / 3.0, samples, 3))
    assert found.factor.sigmas == pytest.approx([math.sqrt(limit) for limit in interval(mean / 3.0, samples, 3)])
    for k, name in enumerate(("forward", "left", "heading")):
        ones = []
        for run in runs:
            turned = run.error.copy()
            turned[:, :2] = (run.orientations.transpose(0, 2, 1) @ run.error[:, :2, None])[:, :, 0]
            cov = run.cov.copy()
            cov[:, :2, :2] = run.orientations.transpose(0, 2, 1) @ cov[:, :2, :2] @ run.orientations
            ones.append((turned[:, k] / np.sqrt(cov[:, k, k]))[:, None])
        squares, one = [own[:, 0] ** 2 for own in ones], found.axes[name]
        value = np.concatenate(squares).mean() / (1.0 - removed)
        samples = worth(squares, effective_number(squares, ones), 1, shared)
        assert (one.value, one.samples) == pytest.approx((value, samples))
        assert one.interval == pytest.approx(interval(value, samples, 1))
    since = [(run.stamps_ns - run.stamps_ns[0]) / (run.stamps_ns[-1] - run.stamps_ns[0]) for run in runs]
    at = np.concatenate(since)
    parts = [together[(at >= k / 5) & ((at < (k + 1) / 5) | (k == 4))].mean() for k in range(5)]
    assert found.parts == pytest.approx(parts)


def found_with(samples, low, high, **changes):
    axes = axes_of([(2.0, 1.5, 2.6)] * 3)
    found = Findings(
        3, 400, samples, 4.2, (2.1, 4.3), 0.874, Factor(1.4, (low, high), samples), axes, (4.0,) * 5, 0.0, 0.0
    )
    return dataclasses.replace(found, **changes)


@pytest.mark.parametrize(("samples", "low", "high", "outcome"), [
    (29.9, 1.2, 1.6, "no verdict"), (30.0, 1.2, 1.6, "overconfident"), (30.0, 1.001, 1.6, "overconfident"),
    (30.0, 0.999, 1.6, "consistent"), (30.0, 0.4, 1.001, "consistent"), (30.0, 0.4, 0.999, "cautious"),
])  # fmt: skip
def test_the_verdict_flips_where_the_interval_leaves_one_and_where_samples_are_too_few(samples, low, high, outcome):
    assert found_with(samples, low, high).outcome == outcome


def verdict(found):
    return dataclasses.replace(ss.audit(*arrays(drawn(3, 2))), findings=found).verdict


def axes_of(rows):
    return {n: Factor(v, (low, high), 50.0) for n, (v, low, high) in zip(("x", "y", "heading"), rows, strict=True)}


def arrays(one):
    return (one.stamps, one.estimate, one.covs), (one.stamps, one.truth)


def test_the_sentence_has_the_interval_of_the_sigmas_and_the_axes_that_deviate_most():
    """Factors of 1.44 to 2.56 are sigmas of 1.2 to 1.6."""
    axes = axes_of([(6.0, 5.0, 7.0), (0.9, 0.8, 1.1), (1.3, 1.1, 1.5)])
    told = "overconfident: errors are 1.20 to 1.60 times the stated sigmas"
    assert verdict(found_with(60.0, 1.44, 2.56, axes=axes)) == f"{told}, mostly in x"
    assert verdict(found_with(60.0, 1.44, 2.56, axes=axes | {"x": axes["heading"]})) == f"{told}, in x and heading"
    assert verdict(found_with(60.0, 1.44, 2.56)) == f"{told}, on all axes"
    axes = axes_of([(0.2, 0.1, 0.3), (0.9, 0.8, 1.1), (0.9, 0.8, 1.2)])
    told = "cautious: errors are 0.50 to 0.80 times the stated sigmas"
    assert verdict(found_with(60.0, 0.25, 0.64, axes=axes)) == f"{told}, mostly in x"
    assert verdict(found_with(60.0, 0.64, 1.44)) == "consistent: errors are 0.80 to 1.20 times the stated sigmas"


@pytest.mark.parametrize(("samples", "nees", "shared", "reason"), [
    (12.0, 4.0, 0.06, "all depend on the first pose"), (12.0, 4.0, 0.04, "errors last too long"),
    (12.0, 16.0, 0.04, "errors last too long"), (12.0, 16.5, 0.04, "is not chance"),
])  # fmt: skip
def test_the_reason_for_no_verdict_is_the_first_pose_an_error_that_stays_or_too_short_a_time(
    samples, nees, shared, reason
):
    """The 99.9 % quantile of chi-square with 3 degrees of freedom is 16.27; the limit of the first pose's share 0.6."""
    told = verdict(found_with(samples, 1.1, 1.5, nees=nees, shared=shared))
    assert told.startswith("no verdict: 400 poses are worth 12 independent ones, 30 are needed") and reason in told


def test_the_report_has_the_numbers_of_the_findings():
    audit = dataclasses.replace(audited("all"), time_offset_s=(-0.0123, 0.0456))
    one, lines = audit.findings, dict(line.split(maxsplit=1) for line in repr(audit).splitlines())
    ratios = [(math.sqrt(a.value), *map(math.sqrt, a.interval)) for a in one.axes.values()]
    ratios = [f"{n} {v:.2f} ({low:.2f} to {high:.2f})" for n, (v, low, high) in zip(one.axes, ratios, strict=True)]
    assert lines["by"] == "axis      errors over stated sigmas: " + ", ".join(ratios)
    assert lines["NEES"] == f"{one.nees:.1f} on average; {one.band[0]:.2f} to {one.band[1]:.2f} is consistent"
    assert lines["over"] == "time    NEES in 5 equal parts: " + ", ".join(f"{part:.1f}" for part in one.parts)
    low, high = one.factor.interval
    assert lines["factor"] == f"{one.factor.value:.2f} for the covariance, {low:.2f} to {high:.2f} with 95 %"
    assert lines["samples"] == f"430 correlated poses are worth {one.samples:.1f} independent ones"
    assert lines["alignment"] == f"by all poses; {100.0 * one.removed:.2g} % of the errors' squares taken off"
    assert lines["time"] == "offset  -12.3 ms, +45.6 ms added to the stamps of the estimate"
    table = dataclasses.replace(audit, findings=dataclasses.replace(one, parts=(math.nan, 1.5))).as_dict()
    assert table["parts"] == [None, 1.5] and table["factor"]["interval"] == list(one.factor.interval)


@pytest.mark.parametrize(
    ("value", "samples", "outcome", "told"),
    [(2.0, 60.0, "consistent", True), (1.5, 60.0, "consistent", False), (2.0, 29.0, "consistent", False),
     (2.0, 60.0, "overconfident", False)],
)  # fmt: skip
def test_a_single_axis_is_noted_if_it_deviates_by_three_sigmas_and_the_whole_does_not(value, samples, outcome, told):
    """With 60 samples the 95 % interval of a factor of 1.5 leaves 1; that of a chance of 5 % in six axes does not."""
    from sixthsense.auditing.result import axis_notes
    from sixthsense.auditing.statistics import factor

    low = 0.9 if outcome == "consistent" else 1.1
    notes = list(
        axis_notes(found_with(60.0, low, 1.6, axes={"x": factor(1.0, 60.0, 1), "y": factor(value, samples, 1)}))
    )
    limits = [math.sqrt(limit) for limit in interval(value, samples, 1)]
    assert limits[0] > 1.0
    assert notes == [f"y alone: errors are {limits[0]:.2f} to {limits[1]:.2f} times the stated sigma"] * told


def test_the_picture_has_the_errors_in_three_sigmas_and_the_quantiles_of_the_middle_of_each_pose():
    audit = audited("none")
    run, picture = audit.runs[0], audit.plot()
    tubes = picture.axes[:3]
    errors, covs = run.in_axes("body")
    for k, scale in enumerate((1.0, 1.0, 180.0 / math.pi)):
        drawn_error = next(line for line in tubes[k].get_lines() if line.get_label() == "error").get_ydata()
        np.testing.assert_allclose(drawn_error, scale * errors[:, k])
        edges = tubes[k].collections[0].get_paths()[0].vertices[:, 1]
        widest = 3.0 * scale * math.sqrt(covs[:, k, k].max())
        assert (edges.min(), edges.max()) == pytest.approx((-widest, widest))
    poses = next(line for line in picture.axes[4].get_lines() if line.get_label() == "poses")
    nees = np.sort(np.concatenate([one.nees for one in audit.runs]))
    np.testing.assert_allclose(poses.get_ydata(), nees)
    np.testing.assert_allclose(poses.get_xdata(), chi2.ppf((np.arange(len(nees)) + 0.5) / len(nees), 3))


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
    (changed(covs=spoilt(1, 1, -0.3)), {}, "in the covariance at"),
    (changed(covs=spoilt(2, 2, math.nan)), {}, "in the covariance at"),
    (changed(covs=SPACE.covs), {}, "found 6 x 6 of planar poses, allowed: 3 x 3"),
    (changed(covs=GOOD.covs * np.array([1.0, 1.0, 0.0]) * np.array([[1.0], [1.0], [0.0]])), {}, "has full rank"),
    (changed(at=GOOD.stamps + 100.0), {}, "times that overlap"),
    (changed(at=GOOD.stamps[:1], truth=GOOD.truth[:1]), {}, "times that overlap"),
    (changed(stamps=GOOD.stamps[:2]), {}, "as many stamps as poses"),
    (changed(stamps=GOOD.stamps[:1], estimate=GOOD.estimate[:1], covs=GOOD.covs[:1]), {"align": "first"}, "two or mor"),
    (changed(), {"time_offset": 0.0}, "allowed: the largest one to search, s, above 0"),
    (changed(), {"time_offset": -0.3}, "allowed: the largest one to search, s, above 0"),
    (changed(), {"time_offset": 50.0}, "allowed: a smaller limit"),
    (changed(), {"frame": "robot"}, "frame: found 'robot'"),
    (([arrays(GOOD)[0], arrays(SPACE)[0]], [arrays(GOOD)[1], arrays(SPACE)[1]]), {}, "allowed: all in one of them"),
    (([arrays(GOOD)[0]] * 3, [arrays(GOOD)[1]] * 2), {}, "truth: found 2 for 3 estimates"),
    (("no.tum", arrays(GOOD)[1]), {}, "no.tum: no such file"),
    ((".", arrays(GOOD)[1]), {}, "found a folder, allowed: a ROS bag"),
    ((3, arrays(GOOD)[1]), {}, "allowed: a file, a run, or arrays"),
    (changed(estimate=np.ones((7, 5))), {}, "estimate poses: expected"),
    (changed(), {"covariance": ["a", "b"]}, "covariance: found 2 for 1 estimates"),
    (changed(), {"truth_frames": ("map",)}, "truth frames: found"),
    (([], []), {}, "estimate: found none"),
    ((arrays(GOOD)[0], None), {}, "truth: found nothing"),
]


def with_nees(nees, heading):
    """A run whose NEES are given, at general headings."""
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [-0.1, 0.05, 0.4]])
    error, cov = np.sqrt(nees)[:, None] * root[:, 0], np.tile(root @ root.T, (len(nees), 1, 1))
    c, s = np.cos(heading), np.sin(heading)
    turns = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    return [Errors(np.arange(len(nees)), error, cov, turns)]


def test_the_other_frame_is_noted_only_if_the_nees_surely_depends_on_the_heading_less_there_and_is_smaller_there():
    rng = np.random.default_rng(8)
    heading, noise = rng.uniform(-3.0, 3.0, 300), rng.uniform(0.3, 0.7, 300)
    depends, even = 3.0 + np.cos(2.0 * heading - 0.7) + noise, 2.9 + 0.01 * noise
    stronger = 1.5 + 1.4 * np.cos(2.0 * heading - 0.7)

    def noted(read, other):
        return is_other_frame(with_nees(read, heading), with_nees(other, heading))

    assert noted(depends, even)
    assert not noted(3.0 + noise, 2.9 + 0.0 * noise)  # read so, it does not depend on the heading
    assert not noted(depends, stronger)
    assert not noted(depends, 2.0 * even)


@pytest.mark.parametrize(("given", "options", "complaint"), REFUSED, ids=[row[2] for row in REFUSED])
def test_an_audit_refuses(given, options, complaint):
    with pytest.raises(ss.InputError) as refusal:
        ss.audit(*given, **options)
    assert complaint in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_single_pose_that_is_exact_is_no_truth_given_twice():
    estimate = GOOD.truth.copy()
    estimate[2, 0, 2] += 0.1
    assert ss.audit(*changed(estimate=estimate)).findings.poses == len(estimate)


def test_a_time_offset_at_the_limit_is_refused_and_the_wrong_sign_is_not_found():
    at = np.linspace(3.0, 43.0, 300)
    truth = np.column_stack([3.0 * np.sin(0.4 * at), 2.0 * np.cos(0.3 * at), np.sin(0.2 * at)])
    late = np.column_stack([np.interp(at - 0.25, at, column) for column in truth.T])
    covs = np.tile(np.diag([2e-4, 3e-4, 1e-4]), (300, 1, 1))
    found = ss.audit((at, late + 1e-3, covs), (at, truth), time_offset=0.4)
    assert found.time_offset_s == pytest.approx((-0.25,), abs=2e-3)
    assert found.runs[0].error[50:].std() < 0.01
    with pytest.raises(ss.InputError, match=r"at the limit of 0.2 s, allowed: a larger limit"):
        ss.audit((at, late, covs), (at, truth), time_offset=0.2)


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


def carried(way, t):
    return np.where(t[:, None] < 97.0, way, moved(way, t))


@pytest.mark.parametrize(("estimate", "truth", "stamps_s", "said"), [
    (same, another, None, "estimate and truth may not be of one drive, or have other clocks: their turns correlate by"),
    (same, moved, None, "the frames differ: aligned by all poses (`align` all) the ATE falls from"),
    (same, lambda way, _: way * (1000.0, 1000.0, 1.0), None, "times those of estimate: are both in metres?"),
    (same, lambda way, _: way + np.array([0.0, 0.0, 0.5 * np.pi]), None, "headings differ by -90° all along"),
    (same, same, lambda t: t + 0.5, "stamps of the estimate are about 0.5 s early, by the errors of headings"),
    (same, same, lambda t: t - 0.5, "stamps of the estimate are about 0.5 s late, by the errors of headings"),
    (carried, same, None, "at 97.00 s the estimate jumps by"),
])  # fmt: skip
def test_errors_that_are_no_estimators_are_told_by_what_they_look_like(estimate, truth, stamps_s, said):
    notes = shown_by(estimate, truth, stamps_s)
    assert len(notes) <= 2 and any(said in note for note in notes)


def test_honest_errors_drift_and_overconfidence_are_not_told_as_another_cause():
    assert shown_by(same, same) == []
    assert shown_by(lambda way, _: 3.0 * (way - way.mean(axis=0)) - 2.0 * way + way.mean(axis=0) * 3.0, same) == []
    rng = np.random.default_rng(6)
    assert shown_by(lambda way, _: way + np.cumsum(rng.normal(0.0, (0.02, 0.02, 0.002), way.shape), axis=0), same) == []
