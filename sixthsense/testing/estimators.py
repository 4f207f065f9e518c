"""The laws of the contract of `Estimator`, clause by clause as `slam/estimators/base.py` numbers them.

Each is checked among points, among walls and among both. Statistics are compared with batch least squares, which shares
no code with the estimators.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.testing.batch import Posterior, batch_posterior, to_robot
from sixthsense.testing.laws import Laws, agree, at_most, equal, raises
from sixthsense.testing.worlds import (
    BOTH,
    MOTION,
    NOISE,
    POINTS,
    ROUNDING,
    START,
    START_COV,
    TOLERANCE,
    WALLS,
    WORLDS,
    Part,
    World,
    assert_agrees,
    assert_same,
    assert_unchanged,
    drive,
    driven,
    fed,
    make,
    marginal,
    state_of,
)

LAWS = Laws()

_EXACT = np.zeros((3, 3))
_NEW = {Kind.WALL: np.array([2.9, -1.5])}  # of a wall, and
_NEW_POINT = np.array([1.0, 0.5])
_PLACES = {"here": Pose(), "turned": Pose(0.0, 0.0, 2.5), "elsewhere": Pose(-8.0, 5.0, -1.2)}
_MOTIONS = {"on an arc": Pose(0.2, 0.0, 0.1), "on the spot": Pose(0.0, 0.0, 0.3), "straight": Pose(0.3, 0.0, 0.0)}
_BAD_COVS = {
    "a value that is not finite": [[0.01, math.nan], [math.nan, 0.01]],
    "not finite": [[math.inf, 0.0], [0.0, 0.01]],
    "an asymmetric matrix": [[0.01, 1e-3], [0.0, 0.01]],
    "an eigenvalue of -0.01": [[0.01, 0.02], [0.02, 0.01]],
}
"""two rows of a covariance, by what an error says of it"""


def _wide(cov: list[list[float]]) -> Array:
    """(3, 3) an invalid covariance of a pose."""
    found = 0.01 * np.eye(3)
    found[:2, :2] = cov
    return found


def _seen(world: World, seed: int, steps: int = 6) -> dict[int, Observation]:
    """Observations of the first and the last landmark at the end of the drive."""
    return world.sight(drive(world, steps)[1], [0, len(world.kinds) - 1], np.random.default_rng(seed))


def _new(world: World) -> Observation:
    """The first observation of a landmark that is of the kind of the world's last one."""
    last = len(world.kinds) - 1
    return world.observation(last, _NEW.get(world.kinds[last], _NEW_POINT))


# 1. Motion


@LAWS.law(1, WORLDS)
def predict_never_shrinks_the_joint_covariance(part: Part, world: World) -> None:
    estimator = driven(part, world)
    exact = [Odometry(motion, _EXACT) for motion in _MOTIONS.values()]
    for motion in (*exact, MOTION, Odometry(Pose(1.0, 0.1, -1.0), MOTION.cov)):
        before = np.linalg.slogdet(state_of(estimator).cov)[1]
        estimator.predict(motion)
        after = np.linalg.slogdet(state_of(estimator).cov)[1]
        at_most("shrinkage of the logarithm of the determinant", before - after, ROUNDING)


@LAWS.law(1, WORLDS)
def zero_motion_at_zero_noise_changes_nothing(part: Part, world: World) -> None:
    one, two = driven(part, world), driven(part, world)
    rows = two.trajectory()
    one.predict(Odometry(Pose(), _EXACT))
    assert_unchanged(one, state_of(two), rows)
    for estimator in (one, two):
        estimator.update(_seen(world, 5))
    assert_same(one, state_of(two))


@LAWS.law(1, WORLDS)
def predicting_in_pieces_is_predicting_at_once(part: Part, world: World) -> None:
    queried, pieces, once = (driven(part, world) for _ in range(3))
    folded = STANDSTILL
    for k in range(5):
        piece = Odometry(Pose(0.1 * k, 0.01, -0.2), MOTION.cov)
        folded = folded.then(piece)
        pieces.predict(piece)
        queried.predict(piece)
        queried.estimate()
    once.predict(folded)
    true = drive(world, 6)[1] @ folded.motion
    for after in ({}, world.sight(true, [0, len(world.kinds) - 1], np.random.default_rng(5))):
        for estimator in (queried, pieces):
            assert_same(estimator, state_of(once))
        for estimator in (queried, pieces, once):
            estimator.update(after)
    for estimator in (queried, pieces):
        assert_unchanged(estimator, state_of(once), once.trajectory())


@LAWS.law(1, WORLDS)
def an_exact_motion_moves_the_pose_and_transports_its_covariance(part: Part, world: World) -> None:
    estimator = driven(part, world)
    before, motion = estimator.estimate(), Pose(0.5, 0.1, 0.2)
    estimator.predict(Odometry(motion, _EXACT))
    after, shift = estimator.estimate(), rotation(before.pose.theta) @ motion.position
    by_pose = np.eye(3)
    by_pose[:2, 2] = -shift[1], shift[0]
    agree("pose", after.pose.array(), (before.pose @ motion).array(), atol=1e-12)
    agree("pose_cov", after.pose_cov, by_pose @ before.pose_cov @ by_pose.T, atol=1e-4 * NOISE**2)


@LAWS.law(1, _MOTIONS)
def a_drive_from_an_exact_start_never_fails(part: Part, name: str) -> None:
    estimator, true = make(part, Pose(), _EXACT), Pose()
    motion, rng = Odometry(_MOTIONS[name], MOTION.cov), np.random.default_rng(3)
    for _ in range(30):
        estimator.predict(motion)
        true = true @ motion.motion
        estimator.update(POINTS.sight(true, range(3), rng))
    state = state_of(estimator)
    at_most("negative eigenvalue", -float(np.linalg.eigvalsh(state.cov)[0]), 1e-12)
    at_most("distance from the truth, m", math.dist(state.mean[:2], true.position), 10.0 * NOISE)


# 2. Updates


@LAWS.law(2, [(world, place, steps) for world in WORLDS for place in _PLACES for steps in (1, 2, 8)])
def a_drive_gives_the_posterior_of_batch_least_squares(part: Part, case: tuple[World, str, int]) -> None:
    """After one update: of new landmarks; after two: of known ones; after eight: of both, and of walls behind."""
    world, place, steps = case
    log, moved = drive(world, steps)[0], _PLACES[place]
    turn = np.eye(3)
    turn[:2, :2] = rotation(moved.theta)
    start, start_cov = moved @ START, turn @ START_COV @ turn.T
    assert_agrees(fed(make(part, start, start_cov), log), batch_posterior(log, start, start_cov))


@LAWS.law(2, WORLDS)
def an_observation_with_zero_innovation_moves_nothing_and_grows_no_marginal(part: Part, world: World) -> None:
    estimator = driven(part, world)
    estimator.predict(MOTION)
    before = state_of(estimator)
    pose, landmarks = before.mean[:3], before.mean[3:].reshape(-1, 2)
    walls = estimator.estimate().walls
    expected = [to_robot(pose, landmark, bool(wall)) for landmark, wall in zip(landmarks, walls, strict=True)]
    estimator.update({i: world.observation(i, z) for i, z in zip(before.ids, expected, strict=True)})
    after, sigmas = state_of(estimator), np.sqrt(np.diag(before.cov))
    agree("mean, in sigma", after.mean / sigmas, before.mean / sigmas, atol=1e-2 * TOLERANCE, rtol=1e-9)
    least = float(np.linalg.eigvalsh((before.cov - after.cov) / np.outer(sigmas, sigmas))[0])
    at_most("growth of a variance in some direction, relative", -least, 1e-4)


@LAWS.law(2, WORLDS)
def known_landmarks_of_a_scan_update_before_new_ones_are_initialized(part: Part, world: World) -> None:
    """After a motion with a hundred times the noise, so that the update moves the pose by many sigmas of a landmark."""
    one, two = driven(part, world), driven(part, world)
    for estimator in (one, two):
        estimator.predict(Odometry(MOTION.motion, 1e4 * MOTION.cov))
    off = MOTION.motion @ Pose(80.0 * NOISE, -60.0 * NOISE, 70.0 * NOISE)
    known = world.sight(drive(world, 6)[1] @ off, [0, 1], np.random.default_rng(5))
    one.update({77: _new(world)} | known)
    two.update(known)
    two.update({77: _new(world)})
    assert_agrees(one, state_of(two))


@LAWS.law(2, WORLDS)
def a_forgotten_landmark_seen_again_is_new(part: Part, world: World) -> None:
    """Its mean and covariance are those of one that was never seen, even far from the old place."""
    one, two, last = driven(part, world), driven(part, world), len(world.kinds) - 1
    for estimator, i in ((one, last), (two, 77)):
        estimator.forget([last])
        estimator.update({i: _new(world)})
    expected = state_of(two)
    assert_agrees(one, Posterior([*expected.ids[:-1], last], expected.mean, expected.cov, expected.angles), 1e-4)


@LAWS.law(2, WORLDS)
def forgetting_a_landmark_leaves_the_others_unchanged(part: Part, world: World) -> None:
    """The marginal stays, or the observations of the forgotten landmark are removed as well, as by a smoother."""
    estimator, last = driven(part, world), len(world.kinds) - 1
    before, rows = state_of(estimator), estimator.trajectory()
    left = [i for i in before.ids if i != last]
    estimator.forget([last])
    try:
        assert_same(estimator, marginal(before, left))
    except AssertionError:
        assert_agrees(estimator, state_of(driven(part, world, unseen=[last])), 1e-3)
    equal("rows of the trajectory", len(estimator.trajectory()), len(rows))
    estimator.update({last: _new(world)})
    equal("landmarks after it was seen again", estimator.estimate().ids.tolist(), [*left, last])


@LAWS.law(2)
def forgetting_no_landmark_or_an_unknown_one_changes_nothing(part: Part) -> None:
    """An unknown one raises a KeyError."""
    estimator = driven(part, POINTS)
    estimator.forget([1])
    before, rows = state_of(estimator), estimator.trajectory()
    estimator.forget([])
    for ids in ([1], [99], [0, 1], [0, 99, 2]):
        with raises(KeyError):
            estimator.forget(ids)
        assert_unchanged(estimator, before, rows)


@LAWS.law(2, WORLDS)
def forgetting_all_landmarks_leaves_the_pose(part: Part, world: World) -> None:
    estimator = driven(part, world)
    estimator.forget(range(len(world.kinds)))
    estimate = estimator.estimate()
    equal("landmarks", estimate.ids.tolist(), [])
    equal("shape of the landmarks", estimate.landmarks.shape, (0, 2))
    equal("shape of the joint covariance", estimator.joint_covariance([]).shape, (3, 3))
    at_most("distance from the truth, m", math.dist(estimate.pose.position, drive(world, 6)[1].position), 20.0 * NOISE)
    estimator.predict(MOTION)
    z = to_robot(estimator.estimate().pose.array(), world.landmarks[0], world.kinds[0] == Kind.WALL)
    estimator.update({0: world.observation(0, z)})
    equal("landmarks", estimator.estimate().ids.tolist(), [0])


@LAWS.law(2)
def the_trajectory_has_one_row_per_update_and_starts_empty(part: Part) -> None:
    """Updates without observations add rows, too: the poses of odometry alone."""
    estimator, folded, rows = make(part), STANDSTILL, []
    equal("shape of the trajectory", estimator.trajectory().shape, (0, 3))
    for k in range(120):
        if k % 3:
            estimator.predict(MOTION)
            folded = folded.then(MOTION)
        estimator.update({})
        rows.append((START @ folded.motion).array())
    agree("trajectory", estimator.trajectory(), np.array(rows), atol=1e-9)
    alone = make(part)
    alone.predict(folded)
    assert_agrees(estimator, state_of(alone), 1e-4)
    estimator.update(POINTS.sight(START @ folded.motion, range(3), np.random.default_rng(2)))
    equal("shape of the trajectory", estimator.trajectory().shape, (121, 3))
    agree("last row", estimator.trajectory()[-1], estimator.estimate().pose.array(), atol=1e-12)


@LAWS.law(2)
def integers_give_the_same_result_as_floats(part: Part) -> None:
    states = []
    for number in (int, float):
        estimator = make(part, Pose(number(0), number(1), number(0)), np.eye(3).astype(number))
        estimator.predict(Odometry(Pose(number(1), number(0), number(1)), np.eye(3).astype(number)))
        estimator.update({0: Observation(Kind.CORNER, np.array([2, 1], number), np.eye(2).astype(number))})
        states.append(state_of(estimator))
    assert_agrees(states[0], states[1], ROUNDING)


# 3. Empty updates, 4. covariances, 5. copies, 6. bits


@LAWS.law(3, WORLDS)
def an_empty_update_leaves_the_covariance_alone(part: Part, world: World) -> None:
    estimator = driven(part, world)
    before = state_of(estimator)
    estimator.update({})
    assert_same(estimator, before)
    equal("rows of the trajectory", len(estimator.trajectory()), 7)


@LAWS.law(4, WORLDS)
def the_joint_covariance_is_symmetric_positive_definite_and_in_the_requested_order(part: Part, world: World) -> None:
    estimator = driven(part, world)
    state, sigmas = state_of(estimator), np.sqrt(np.diag(estimator.joint_covariance([0, 1, 2])))
    assert len(state.ids) == len(world.kinds), f"found landmarks {state.ids}"
    at_most("asymmetry, relative", float(np.abs((state.cov - state.cov.T) / np.abs(state.cov).max()).max()), 1e-13)
    at_most("negative eigenvalue", -float(np.linalg.eigvalsh(state.cov)[0]), 0.0)
    for ids in ([2, 0], [1], [0, 2, 1], []):
        found, expected = estimator.joint_covariance(ids), marginal(state, ids).cov
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        agree(f"correlations of landmarks {ids}", found / scale, expected / scale, atol=1e-7)
    scale = np.outer(sigmas[:3], sigmas[:3])
    agree("pose_cov", estimator.estimate().pose_cov / scale, state.cov[:3, :3] / scale, atol=1e-7)
    with raises(KeyError):
        estimator.joint_covariance([99])


@LAWS.law(5, WORLDS)
def returned_arrays_are_copies(part: Part, world: World) -> None:
    estimator = driven(part, world)
    for motion in (STANDSTILL, MOTION):
        estimator.predict(motion)
        estimate, before, rows = estimator.estimate(), state_of(estimator), estimator.trajectory()
        joint, alone = estimator.joint_covariance(before.ids), estimator.joint_covariance([])
        kept = rows.copy()
        for array in (estimate.landmarks, estimate.pose_cov, estimate.ids, estimate.walls, rows, joint, alone):
            array[:] = 1
        assert_unchanged(estimator, before, kept)


@LAWS.law(5, WORLDS)
def arguments_may_change_after_the_call(part: Part, world: World) -> None:
    one, two = driven(part, world), driven(part, world)
    one.predict(MOTION)
    one.update(_seen(world, 5))
    motion, seen = Odometry(MOTION.motion, MOTION.cov.copy()), _seen(world, 5)
    two.predict(motion)
    motion.cov[:] = 7.0
    copies = {i: Observation(s.kind, s.z, s.cov.copy(), s.extent) for i, s in seen.items()}
    two.update(copies)
    for observation in copies.values():
        observation.z[:], observation.cov[:] = 9.0, 9.0
    assert_same(two, state_of(one))


@LAWS.law(6, WORLDS)
def the_same_calls_give_the_same_bits(part: Part, world: World) -> None:
    """But for the last ones: the rounding of a matrix product may depend on where its operands lie in memory."""
    one, two = (state_of(driven(part, world)) for _ in range(2))
    agree("mean", one.mean, two.mean, rtol=1e-13)
    agree("covariance", one.cov, two.cov, atol=1e-9 * float(np.abs(two.cov).max()))


# 7. Invalid input, which a part may leave to its users, and 8. walls


@LAWS.law(7, _BAD_COVS, is_optional=True)
def an_invalid_start_covariance_is_named(part: Part, fault: str) -> None:
    with raises(ValueError, f"start_cov: .*{fault}"):
        make(part, START, _wide(_BAD_COVS[fault]))


@LAWS.law(7, _BAD_COVS, is_optional=True)
def an_invalid_covariance_of_odometry_is_named_and_changes_nothing(part: Part, fault: str) -> None:
    estimator = driven(part, POINTS)
    before, rows = state_of(estimator), estimator.trajectory()
    for motion in (Pose(0.1, 0.0, 0.0), Pose()):
        with raises(ValueError, f"odometry: .*{fault}"):
            estimator.predict(Odometry(motion, _wide(_BAD_COVS[fault])))
        assert_unchanged(estimator, before, rows)


@LAWS.law(7, [(fault, world) for world in (POINTS, WALLS) for fault in _BAD_COVS], is_optional=True)
def an_invalid_observation_is_named_with_its_landmark_and_changes_nothing(part: Part, case: tuple[str, World]) -> None:
    """The valid observations of the same scan are refused as well."""
    fault, world = case
    bad = world.observation(2, _new(world).z, np.array(_BAD_COVS[fault]))
    _assert_refused(part, world, bad, fault)


@LAWS.law(7, (POINTS, WALLS), is_optional=True)
def a_singular_covariance_and_a_place_that_is_not_finite_are_named(part: Part, world: World) -> None:
    singular = world.observation(2, _new(world).z, np.diag([0.01, 0.0]))
    _assert_refused(part, world, singular, "singular|eigenvalue")
    _assert_refused(part, world, world.observation(2, np.array([math.nan, -2.0])), "z")


def _assert_refused(part: Part, world: World, bad: Observation, fault: str) -> None:
    estimator = driven(part, world)
    before, rows, good = state_of(estimator), estimator.trajectory(), _seen(world, 0)
    for seen in (good | {41: bad}, {1: bad}):
        with raises(ValueError, f"landmark {[*seen][-1]}: .*({fault})"):
            estimator.update(seen)
        assert_unchanged(estimator, before, rows)
    estimator.update(good)
    equal("rows of the trajectory", len(estimator.trajectory()), len(rows) + 1)


@LAWS.law(8)
def a_scan_with_a_wall_is_used_or_refused_as_a_whole(part: Part) -> None:
    """An estimator without walls raises NotImplementedError and leaves its state unchanged."""
    estimator = driven(part, POINTS)
    before, rows = state_of(estimator), estimator.trajectory()
    try:
        estimator.update(_seen(POINTS, 5) | {9: _new(WALLS)})
    except NotImplementedError:
        assert_unchanged(estimator, before, rows)
    else:
        equal("landmarks", estimator.estimate().ids.tolist(), [*before.ids, 9])


@LAWS.law(8, [BOTH])
def walls_are_returned_as_walls(part: Part, world: World) -> None:
    estimate = driven(part, world).estimate()
    equal("type of walls", estimate.walls.dtype, np.dtype(np.bool_))
    equal("walls", estimate.walls.tolist(), [world.kinds[i] == Kind.WALL for i in estimate.ids])
    alpha = estimate.landmarks[estimate.walls, 0]
    assert ((alpha >= -math.pi) & (alpha < math.pi)).all(), f"found angles {alpha.tolist()}, allowed: [-pi, pi)"
