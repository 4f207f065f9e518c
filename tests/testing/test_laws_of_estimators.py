"""Each clause of the contract of estimators has estimators that break it, and the law that finds them."""

import itertools
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from laws import links, parameters, prior_map

from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimator, Filter, Smoother
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing import check_estimator
from sixthsense.testing.check import LAWS
from sixthsense.testing.estimation import CONVERGED, rotated_covariance, step

CHECKS = {law.name: law.check for law in (*LAWS, *parameters.LAWS, *parameters.WALLS, *prior_map.LAWS, *links.LAWS)}
LEAST_SQUARES = "a_drive_gives_the_posterior_of_batch_least_squares [{}]"
FIRST_UPDATE = "the_first_update_gives_the_posterior_of_batch_least_squares [{}]"
NEW = "new_landmarks_have_the_joint_covariance_of_batch_least_squares [{}]"
ORDERED = "the_joint_covariance_is_symmetric_positive_definite_and_in_the_requested_order"


class Smooths(ISAM2):
    def __init__(self, start, start_cov, _):
        super().__init__(start, start_cov, CONVERGED)


def broken(base=EKF, **calls):
    """A shipped estimator with other calls: functions of the estimator, of its own call, and of the arguments."""

    def method(name, other):
        return lambda own, *args: other(own, partial(getattr(base, name), own), *args)

    return type("Broken", (base,), {name: method(name, other) for name, other in calls.items()})


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


def noise_in_world_axes(own, call, odometry):
    call(replace(odometry, cov=rotated_covariance(-own.estimate().pose.theta, odometry.cov)))


def with_a_floor(own, call, seen):
    call({i: replace(s, cov=s.cov + 2.5e-8 * np.eye(2)) for i, s in seen.items()})


def counts_twice(own, call, seen):
    """Uses an observation again if the landmark was seen in the update before, too."""
    call(scaled(seen, 0.5, getattr(own, "last", ())))
    own.last = {*seen}


def augments_first(own, call, seen):
    before = known(own)
    call({i: s for i, s in seen.items() if i not in before})
    call({i: s for i, s in seen.items() if i in before})


class RemembersTheForgotten(EKF):
    """Hides forgotten landmarks, and finds them again."""

    _hidden = frozenset()

    def forget(self, ids):
        if not {*ids} <= known(self):
            raise KeyError(ids)
        self._hidden |= {*ids}

    def update(self, observations):
        self._hidden -= {*observations}
        super().update(observations)

    def estimate(self):
        found = super().estimate()
        kept = ~np.isin(found.ids, [*self._hidden])
        return replace(found, ids=found.ids[kept], landmarks=found.landmarks[kept], walls=found.walls[kept])


def forgets_another(own, call, ids):
    every = own.estimate().ids.tolist()
    call([every[(every.index(i) + 1) % len(every)] for i in ids])


def with_joint(change):
    """Changes a joint covariance with landmarks."""
    return broken(joint_covariance=lambda own, call, ids: change(call(ids)) if len(ids) else call(ids))


def asymmetric(joint):
    joint[1, 0] *= 1.0 + 1e-12
    return joint


def indefinite(joint):
    return joint - 1.001 * np.linalg.eigvalsh(joint)[0] * np.eye(len(joint))


def of_another_pose(joint):
    joint[0, 0] *= 1.0 + 1e-9
    return joint


def uncorrelated(joint):
    joint[3:, :3] = joint[:3, 3:] = 0.0
    return joint


def of_pairs(change):
    """Changes the blocks (2, 2) of two landmarks each."""

    def changed(joint):
        for i, j in itertools.combinations(range(3, len(joint), 2), 2):
            block = change(joint[i : i + 2, j : j + 2])
            joint[i : i + 2, j : j + 2], joint[j : j + 2, i : i + 2] = block, block.T
        return joint

    return with_joint(changed)


def views_of(name):
    """Returns the same array of one of the calls until the state changes."""

    def kept(own, call, *args):
        return own.__dict__.setdefault("memo", {}).setdefault(str(args), call(*args))

    def changed(own, call, given):
        own.memo = {}
        call(given)

    return broken(predict=changed, update=changed, **{name: kept})


def moves_at_random(own, call, numbers=itertools.count()):  # noqa: B008
    estimate = call()
    return replace(estimate, pose=replace(estimate.pose, x=estimate.pose.x + 1e-12 * next(numbers)))


def instead(*others):
    """Takes something else where the input is invalid."""

    def other(own, call, *given):
        try:
            call(*given)
        except ValueError:
            call(*given[: len(given) - len(others)], *others)

    return other


def names_nothing(own, call, seen):
    try:
        call(seen)
    except ValueError:
        raise ValueError("invalid input") from None


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
    (1, surer("predict"), "predict_never_shrinks_the_joint_covariance"),
    (1, broken(predict=lambda own, call, o: call(replace(o, cov=0.0 * o.cov))), FIRST_UPDATE.format("points")),
    (1, broken(predict=noise_in_world_axes), LEAST_SQUARES.format("walls")),
    (1, LATE, "predicting_in_pieces_is_predicting_at_once"),
    (2, of_known(0.25), FIRST_UPDATE.format("points")),
    (2, of_known(0.9), FIRST_UPDATE.format("walls")),
    (2, of_known(0.9), "an_update_adds_the_information_of_its_observations [points and walls]"),
    (2, of_new(1.1), NEW.format("points")),
    (2, of_new(0.9), NEW.format("walls")),
    (2, of_new(1.1), "a_new_landmark_is_initialized_from_its_observation"),
    (2, of_new(1.1), "a_new_wall_is_initialized_from_its_observation"),
    (2, broken(update=with_a_floor), "two_updates_with_one_observation_equal_one_with_half_its_covariance [points]"),
    (2, broken(update=counts_twice), "the_order_of_two_updates_makes_no_difference [walls]"),
    (2, broken(update=augments_first), "known_landmarks_of_a_scan_update_before_new_ones_are_initialized"),
    (2, with_joint(uncorrelated), "a_new_landmark_is_initialized_from_its_observation"),
    (2, RemembersTheForgotten, "a_forgotten_landmark_seen_again_is_new"),
    (2, broken(forget=forgets_another), "forgetting_a_landmark_leaves_the_others_unchanged"),
    (2, broken(forget=forgets_another), "forgetting_a_wall_leaves_the_others_unchanged"),
    (2, broken(forget=lambda own, call, ids: [call([i]) for i in ids]),
     "forgetting_an_unknown_landmark_is_a_key_error_and_changes_nothing"),
    (2, broken(trajectory=lambda own, call: call()[1:]), "the_trajectory_has_one_row_per_update_and_starts_empty"),
    (3, surer("update", lambda seen: not seen), "an_empty_update_leaves_the_covariance_alone"),
    (4, with_joint(asymmetric), ORDERED),
    (4, with_joint(indefinite), ORDERED),
    (4, with_joint(of_another_pose), ORDERED),
    (4, broken(joint_covariance=lambda own, call, ids: call(sorted(ids))), ORDERED),
    (4, broken(joint_covariance=lambda own, call, ids: call(sorted(ids))),
     "the_joint_covariance_of_points_and_walls_is_in_the_requested_order"),
    (4, broken(joint_covariance=lambda own, call, ids: call([i for i in ids if i in known(own)])), ORDERED),
    (4, of_pairs(lambda block: block.T.copy()), LEAST_SQUARES.format("points")),
    (4, of_pairs(lambda block: 0.5 * block), LEAST_SQUARES.format("walls")),
    (5, views_of("estimate"), "returned_arrays_are_copies"),
    (5, views_of("joint_covariance"), "returned_arrays_are_copies"),
    (5, views_of("trajectory"), "returned_arrays_are_copies"),
    (5, LATE, "arguments_may_change_after_the_call"),
    (6, broken(estimate=moves_at_random), "the_same_input_gives_the_same_bits"),
    (7, broken(__init__=instead(np.eye(3))), "an_invalid_start_covariance_is_named [not finite]"),
    (7, broken(predict=instead(step())),
     "an_invalid_odometry_covariance_is_named_and_changes_nothing [an eigenvalue of -0.01]"),
    (7, broken(update=instead({})), "an_invalid_observation_is_named_and_changes_nothing [a singular covariance]"),
    (7, broken(update=lambda own, call, seen: [call({i: s}) for i, s in seen.items()]),
     "an_invalid_observation_is_named_and_changes_nothing [an asymmetric matrix]"),
    (7, broken(update=names_nothing), "the_error_of_an_observation_names_its_landmark"),
    (7, broken(update=names_nothing),
     "an_invalid_observation_of_a_wall_is_named_and_changes_nothing [an eigenvalue of -0.01]"),
    (7, broken(__init__=exact_start_refused), "a_drive_from_an_exact_start_never_fails [0]"),
    (8, refuses_walls(NotImplementedError, late=True), "a_scan_with_a_wall_is_used_or_refused_as_a_whole"),
    (8, refuses_walls(TypeError, late=False), "a_scan_with_a_wall_is_used_or_refused_as_a_whole"),
    (8, broken(estimate=lambda own, call: replace(call(), walls=call().walls & False)), "a_wall_is_returned_as_a_wall"),
    (9, broken(start_from=lambda own, call, prior: call(replace(prior, cov=0.5 * prior.cov))),
     "the_first_observations_add_their_information_to_the_prior [points]"),
    (9, broken(start_from=lambda own, call, prior: call(replace(prior, ids=prior.ids + 1))),
     "before_any_motion_the_landmarks_are_their_prior_and_independent_of_the_start [walls]"),
    (9, surer("forget"), "a_forgotten_landmark_leaves_the_marginal_of_the_others [points and walls]"),
    (10, broken(predict=lambda own, call, o: call(replace(o, wheels=None))),
     "a_drive_with_uncertain_wheels_gives_the_posterior_of_batch_least_squares [points]"),
    (10, broken(calibration=lambda own, call, kind: call(kind) and replace(call(kind), cov=0.999 * call(kind).cov)),
     "odometry_that_does_not_depend_on_the_wheels_leaves_them_alone"),
    (11, broken(update=lambda own, call, seen: call({i: replace(s, sensor=None) for i, s in seen.items()})),
     "parameters_and_pose_converge_to_the_truth_as_noise_goes_to_zero [sensor]"),
    (12, broken(calibration=lambda own, call, kind: call(kind) and replace(call(kind), cov=0.999 * call(kind).cov)),
     "before_any_motion_the_parameters_keep_their_prior [sensor]"),
    (13, broken(Smooths, link=lambda own, call, given: call(
        [replace(k, relative=Odometry(k.relative.motion, 0.25 * k.relative.cov)) for k in given])),
     "links_give_the_least_squares_solution"),
    (14, broken(Smooths, unlink=lambda own, call, ids: None), "removed_links_leave_no_trace"),
    (15, broken(Smooths, poses_at=lambda own, call, updates: call(updates)[::-1]),
     "poses_at_some_updates_are_rows_of_the_trajectory"),
]  # fmt: skip
"""clause of the contract, an estimator that breaks it, and the law that is to find it"""


@pytest.mark.parametrize(("clause", "cls", "law"), BROKEN, ids=[f"{clause}-{law}" for clause, _, law in BROKEN])
def test_an_estimator_that_breaks_a_clause_breaks_its_law(clause, cls, law):
    CHECKS[law](Smooths if clause > 12 else EKF)
    with pytest.raises((AssertionError, KeyError, TypeError, np.linalg.LinAlgError)):
        CHECKS[law](cls)


def test_every_clause_has_an_estimator_that_breaks_it():
    numbers = re.findall(r"^ +(\d+)\. ", f"{Estimator.__doc__}{Filter.__doc__}{Smoother.__doc__}", re.MULTILINE)
    # That of poses that are taken out has tests of its own, for the one smoother.
    assert {clause for clause, _, _ in BROKEN} == {int(number) for number in numbers} - {16}


def test_laws_of_walls_are_skipped_with_the_reason_for_an_estimator_of_points():
    verdicts = check_estimator(refuses_walls(NotImplementedError, late=False))
    of_walls = [law.name for law in LAWS if law.needs_walls]
    assert verdicts.kept and list(verdicts.skipped) == of_walls and len(verdicts) == len(LAWS) - len(of_walls)
    reason = "NotImplementedError: walls are not supported"
    assert repr(verdicts).splitlines()[-1] == f"not tested: {len(of_walls)} laws, {reason}"


def test_another_error_for_a_wall_is_no_refusal():
    verdicts = check_estimator(refuses_walls(TypeError, late=False))
    assert not verdicts.skipped and all(verdicts[law.name] for law in LAWS if law.needs_walls)
