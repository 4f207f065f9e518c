"""Estimators that break a clause of their contract, and the law that finds each; honesty on the landmark circle."""

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from laws import links, parameters, prior_map
from point_world import CONVERGED, broken, rotated_covariance, step
from scipy.linalg import block_diag

from sixthsense.config import ISAM2Config
from sixthsense.core.arcs import arc_jacobian, arc_length
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.motion import Odometry, rk4
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import Estimator, Filter, Smoother
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing import check_estimator, estimator_checks
from sixthsense.testing.batch import observation_jacobian, to_robot, to_world
from sixthsense.testing.circle import ODOMETRY_COV, RADIUS, follow, simulate
from sixthsense.testing.estimators import LAWS
from sixthsense.testing.laws import Laws

EVERY = Laws([*LAWS, *parameters.LAWS, *parameters.WALLS, *prior_map.LAWS, *links.LAWS])
LEAST_SQUARES = "a drive gives the posterior of batch least squares [{}, here, 8]"
FIRST_UPDATE = "a drive gives the posterior of batch least squares [{}, here, 2]"
NEW = "a drive gives the posterior of batch least squares [{}, elsewhere, 1]"
ORDERED = "the joint covariance is symmetric positive definite and in the requested order [{}]"


class Smooths(ISAM2):
    def __init__(self, start, start_cov, _):
        super().__init__(start, start_cov, CONVERGED)


def known(own):
    return {*own.estimate().ids.tolist()}


def scaled(observations, factor, ids):
    """Observations whose covariance is `factor` times as large, if they are of these landmarks."""
    return {i: replace(s, cov=factor * s.cov) if i in ids else s for i, s in observations.items()}


def of_known(factor):
    return broken(update=lambda own, call, seen: call(scaled(seen, factor, known(own))))


def of_new(factor):
    return broken(update=lambda own, call, seen: call(scaled(seen, factor, {*seen} - known(own))))


def told(own, call, *ids):
    found, factor = call(*ids), getattr(own, "factor", 1.0)
    return factor * found if ids else replace(found, pose_cov=factor * found.pose_cov)


def surer(name, when=lambda given: True):
    """Says a smaller covariance after each of these calls."""

    def other(own, call, given):
        call(given)
        own.factor = getattr(own, "factor", 1.0) * (0.98 if when(given) else 1.0)

    return broken(**{name: other}, estimate=told, joint_covariance=told)


def late(own, call, *args):
    """Moves only now, by the latest motion, as its arrays are now."""
    motion, own.latest = getattr(own, "latest", None), None
    if motion is not None:
        EKF.predict(own, motion)
    return call(*args)


LATE = broken(
    predict=lambda own, call, odometry: setattr(own, "latest", odometry),
    update=late, estimate=late, joint_covariance=late,
)  # fmt: skip


def augments_first(own, call, seen):
    before = known(own)
    call({i: s for i, s in seen.items() if i not in before})
    call({i: s for i, s in seen.items() if i in before})


def forgets_another(own, call, ids):
    every = own.estimate().ids.tolist()
    call([every[(every.index(i) + 1) % len(every)] for i in ids])


def with_joint(change):
    """Changes a joint covariance with landmarks."""
    return broken(joint_covariance=lambda own, call, ids: change(call(ids)) if len(ids) else call(ids))


def moves_at_random(own, call, numbers=itertools.count()):  # noqa: B008
    estimate = call()
    return replace(estimate, pose=replace(estimate.pose, x=estimate.pose.x + 1e-11 * next(numbers)))


def instead(*others):
    """Takes something else where the input is invalid."""

    def other(own, call, *given):
        try:
            call(*given)
        except ValueError:
            call(*given[: len(given) - len(others)], *others)

    return other


def exact_start_refused(own, call, start, cov):
    np.linalg.cholesky(cov)
    call(start, cov)


def refuses_walls(error, late):
    def update(own, call, seen):
        points = {i: s for i, s in seen.items() if not s.is_wall}
        if late or len(points) == len(seen):
            call(points)
        if len(points) < len(seen):
            raise error("walls are not supported")

    return broken(update=update)


BROKEN = [
    (1, surer("predict"), "predict never shrinks the joint covariance [walls]"),
    (1, broken(predict=lambda own, call, o: call(replace(o, cov=0.0 * o.cov))), FIRST_UPDATE.format("points")),
    (1, broken(predict=lambda own, call, o: call(
        replace(o, cov=rotated_covariance(-own.estimate().pose.theta, o.cov)))), LEAST_SQUARES.format("walls")),
    (1, LATE, "predicting in pieces is predicting at once [points]"),
    (2, of_known(0.25), FIRST_UPDATE.format("points")),
    (2, of_new(1.1), NEW.format("points")),
    (2, broken(update=augments_first), "known landmarks of a scan update before new ones are initialized [walls]"),
    (2, with_joint(lambda joint: block_diag(joint[:3, :3], joint[3:, 3:])), NEW.format("points and walls")),
    (2, broken(forget=lambda own, call, ids: call([]) if {*ids} <= known(own) else call(ids)),
     "a forgotten landmark seen again is new [points]"),
    (2, broken(forget=forgets_another), "forgetting a landmark leaves the others unchanged [walls]"),
    (2, broken(forget=lambda own, call, ids: [call([i]) for i in ids]),
     "forgetting no landmark or an unknown one changes nothing"),
    (2, broken(trajectory=lambda own, call: call()[1:]), "the trajectory has one row per update and starts empty"),
    (3, surer("update", lambda seen: not seen), "an empty update leaves the covariance alone [points]"),
    (4, with_joint(lambda joint: joint + 1e-6 * joint[0, 0] * np.eye(len(joint), k=-1)), ORDERED.format("points")),
    (4, broken(joint_covariance=lambda own, call, ids: call(sorted(ids))), ORDERED.format("points and walls")),
    (4, broken(joint_covariance=lambda own, call, ids: call([i for i in ids if i in known(own)])),
     ORDERED.format("points")),
    (5, broken(trajectory=lambda own, call: own.__dict__.setdefault(f"until update {len(call()) + 1}", call())),
     "returned arrays are copies [walls]"),
    (5, LATE, "arguments may change after the call [points]"),
    (6, broken(estimate=moves_at_random), "the same calls give the same bits [points]"),
    (7, broken(__init__=instead(np.eye(3))), "an invalid start covariance is named [not finite]"),
    (7, broken(predict=instead(step())),
     "an invalid covariance of odometry is named and changes nothing [an eigenvalue of -0.01]"),
    (7, broken(update=lambda own, call, seen: [call({i: s}) for i, s in seen.items()]),
     "an invalid observation is named with its landmark and changes nothing [an asymmetric matrix, points]"),
    (7, broken(__init__=exact_start_refused), "a drive from an exact start never fails [on the spot]"),
    (8, refuses_walls(NotImplementedError, late=True), "a scan with a wall is used or refused as a whole"),
    (8, refuses_walls(TypeError, late=False), "a scan with a wall is used or refused as a whole"),
    (8, broken(estimate=lambda own, call: replace(call(), walls=call().walls & False)),
     "walls are returned as walls [points and walls]"),
    (9, broken(start_from=lambda own, call, prior: call(replace(prior, cov=0.5 * prior.cov))),
     "the first observations add their information to the prior [points]"),
    (10, broken(predict=lambda own, call, o: call(replace(o, wheels=None))),
     "a drive with uncertain wheels gives the posterior of batch least squares [points]"),
    (10, broken(calibration=lambda own, call, kind: call(kind) and replace(call(kind), cov=0.999 * call(kind).cov)),
     "before any motion the parameters keep their prior [wheels]"),
    (11, broken(update=lambda own, call, seen: call({i: replace(s, sensor=None) for i, s in seen.items()})),
     "parameters and pose converge to the truth as noise goes to zero [sensor]"),
    (12, broken(calibration=lambda own, call, kind: call(kind) and replace(call(kind), cov=0.999 * call(kind).cov)),
     "before any motion the parameters keep their prior [sensor]"),
    (13, broken(Smooths, link=lambda own, call, given: call(
        [replace(k, relative=Odometry(k.relative.motion, 0.25 * k.relative.cov)) for k in given])),
     "links give the least squares solution"),
    (14, broken(Smooths, unlink=lambda own, call, ids: None), "removed links leave no trace"),
    (15, broken(Smooths, poses_at=lambda own, call, updates: call(updates)[::-1]),
     "poses at some updates are rows of the trajectory"),
    (16, broken(Smooths, take_out=lambda own, call, updates: call(updates)[1:]),
     "a pose that is taken out loses its links and leaves its motion and its row"),
]  # fmt: skip
"""clause of the contract, an estimator that breaks it, and the law that is to find it"""


@pytest.mark.parametrize(("clause", "cls", "law"), BROKEN, ids=[f"{clause}-{law}" for clause, _, law in BROKEN])
def test_an_estimator_that_breaks_a_clause_breaks_its_law(clause, cls, law):
    EVERY.named(law).check(Smooths if clause > 12 else EKF)
    with pytest.raises((AssertionError, KeyError, TypeError, np.linalg.LinAlgError)):
        EVERY.named(law).check(cls)


def test_every_clause_has_an_estimator_that_breaks_it_and_laws_name_their_clause():
    numbers = re.findall(r"^ +(\d+)\. ", f"{Estimator.__doc__}{Filter.__doc__}{Smoother.__doc__}", re.MULTILINE)
    assert {clause for clause, _, _ in BROKEN} == {int(number) for number in numbers}
    assert {int(law.name.partition(":")[0].removeprefix("clause ")) for law in LAWS} == set(range(1, 9))


def test_laws_of_walls_are_skipped_with_the_reason_for_an_estimator_of_points():
    failures = check_estimator(refuses_walls(NotImplementedError, late=False))
    of_walls = [law.name for law in LAWS if law.needs_walls]
    assert failures.kept and not failures and [*failures.skipped] == of_walls
    assert failures.tested == len(LAWS) - len(of_walls)
    reason = "NotImplementedError: walls are not supported"
    assert repr(failures).splitlines()[-1] == f"not tested: {len(of_walls)} laws, {reason}"
    assert not check_estimator(refuses_walls(TypeError, late=False)).skipped, "another error is no refusal"


def test_a_broken_law_is_named_with_its_clause_what_was_found_and_what_is_allowed():
    failures = check_estimator(
        broken(joint_covariance=lambda own, call, ids: call([i for i in ids if i in known(own)]))
    )
    (name,) = {name.partition(" [")[0] for name in failures}
    assert name == f"clause 4: {ORDERED.partition(' [')[0]}"
    assert {*failures.values()} == {"found no error, allowed: KeyError"}
    assert repr(failures).splitlines()[0] == f"breaks {len(failures)} of {len(LAWS)} laws"


def test_validation_may_be_left_to_the_user():
    failures = check_estimator(broken(predict=instead(step())))
    assert failures.kept and failures and all(name.startswith("clause 7: ") for name in failures)


def test_pytest_takes_the_checks_one_by_one():
    checks = dict(estimator_checks(surer("update", lambda seen: not seen)))
    assert [*checks] == [law.name for law in LAWS]
    checks["clause 5: returned arrays are copies [walls]"]()
    with pytest.raises(AssertionError, match=r"^covariance: found 0\.98"):
        checks["clause 3: an empty update leaves the covariance alone [walls]"]()


def through_the_information(cov):
    """A covariance as a filter returns it that keeps its inverse; a singular one as it is."""
    if not len(cov) or np.linalg.cond(cov) > 1e12:
        return cov
    found = np.linalg.inv(np.linalg.inv(cov))
    return 0.5 * (found + found.T)


INFORMATION = broken(
    joint_covariance=lambda own, call, ids: through_the_information(call(ids)),
    estimate=lambda own, call: replace(call(), pose_cov=through_the_information(call().pose_cov)),
)


def test_rounding_of_an_inverse_breaks_no_law():
    failures = check_estimator(INFORMATION)
    assert failures.kept, failures


def test_the_reference_of_the_laws_has_the_observation_model_of_the_package():
    """Written twice, once by formulae and once by geometry; Jacobians by formulae and by differences."""
    rng = np.random.default_rng(0)
    for k in range(60):
        pose, landmark, is_wall = rng.uniform(-3, 3, 3), rng.uniform(-3, 3, 2), k % 2 == 0
        z, by_pose, by_landmark = predictions(tuple(pose), landmark[None], np.array([is_wall]))
        found = to_robot(pose, landmark, is_wall)
        for one, other in ((found, z[0]), (to_world(pose, found, is_wall), landmark)):
            off = one - other
            assert max(abs(wrap_angle(float(off[0])) if is_wall else off[0]), abs(off[1])) < 1e-12
        expected = np.hstack([by_pose[0], by_landmark[0]])
        assert np.allclose(observation_jacobian(pose, landmark, is_wall), expected, atol=1e-8)


def test_the_true_path_is_the_circle_without_noise():
    truth = simulate(0, 0, 480).truth
    np.testing.assert_allclose(np.hypot(truth[:, 0], truth[:, 1] - RADIUS), RADIUS)
    np.testing.assert_allclose(truth[239], np.zeros(3), atol=1e-9)  # once round in 240 steps
    first = Pose.from_array(truth[0])
    assert (arc_length(*first.triple()), first.theta) == pytest.approx((0.25, math.radians(1.5)))
    step = rk4(Pose(), 0.25, math.radians(1.5), 1.0)
    assert math.dist(first.position, step.position) < 1e-9


def test_the_covariance_of_odometry_has_rank_two_after_one_step_and_three_after_two():
    evidence = simulate(0, 0, 3)
    for odometry in evidence.odometry:
        g = arc_jacobian(arc_length(*odometry.motion.triple()), odometry.motion.theta)
        np.testing.assert_allclose(odometry.cov, g @ ODOMETRY_COV @ g.T, atol=1e-15)
        assert np.linalg.matrix_rank(odometry.cov) == 2
    assert evidence.full_rank_from == 1 and np.isnan(follow("ekf", evidence).nees3).tolist() == [True, False, False]


@pytest.mark.parametrize("threshold", [0.1, 0.01])
def test_the_smoother_ends_near_the_invariant_filter(threshold):
    """Both see all evidence and lose none of it to an invented heading: they differ by less than they err."""
    evidence = simulate(2, 0, 300)
    smoother = follow("isam2", evidence, ISAM2Config(relinearize_threshold=threshold))
    invariant = follow("ekf-invariant", evidence)
    gap = np.abs(wrap_angle(smoother.heading - invariant.heading))
    assert np.sqrt(np.mean(gap**2)) < 0.2 * np.sqrt(np.mean(invariant.heading**2))


@pytest.mark.slow
def test_only_the_standard_filter_is_inconsistent():
    """40 whole runs of the filters, each band that of 40 runs."""
    evidence = [simulate(0, run) for run in range(40)]
    tracks = {name: [follow(name, own) for own in evidence] for name in ("ekf", "ekf-invariant")}
    rms = {name: math.sqrt(np.mean([track.position_m**2 for track in own])) for name, own in tracks.items()}
    for field, dof in (("nees3", 3), ("nees3_invariant", 3), ("nees_heading", 1)):
        low, high = nees_band(40, dof, confidence=0.999)
        found = {name: np.mean([np.nanmean(getattr(track, field)) for track in own]) for name, own in tracks.items()}
        assert found["ekf"] > high
        assert low < found["ekf-invariant"] < high and rms["ekf-invariant"] < 0.9 * rms["ekf"]
