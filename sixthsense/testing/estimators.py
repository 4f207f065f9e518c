"""The laws of the contract of `Estimator`, clause by clause as `slam/estimators/base.py` numbers them.

Each is checked on drives through small worlds of points, of walls and of both. Statistics are compared with batch least
squares, which shares no code with the estimators.

The noise is small, so that all estimators linearize at nearly the same place: their posteriors differ by about the
noise, relative to a lever of 1 m. A wrong covariance of an observation, a wrong Jacobian or a lost correlation changes
the posterior by a part of itself, whatever the noise.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import block_diag

from sixthsense.config import ISAM2Config
from sixthsense.config.parts import ESTIMATORS, options_class
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.slam.estimators import Estimate, Estimator, EstimatorFactory, make_estimator
from sixthsense.testing.batch import Log, Posterior, batch_posterior, to_robot
from sixthsense.testing.laws import Laws, agree, at_most, equal, raises

Part = str | EstimatorFactory
"""an estimator's name or class"""

NOISE = 2.5e-4  # m and rad; GTSAM drops the correlations of a covariance whose off-diagonal is below 1e-9
TOLERANCE = 0.01  # of a sigma, and of a variance in any direction
ROUNDING = 1e-6  # the same, where nothing but the order of computation differs
# Away from the world's origin, where the offset of a wall depends strongly on its angle.
START = Pose(4.0, -3.0, 0.4)
START_COV = NOISE**2 * np.array([[2.0, 0.5, 0.3], [0.5, 3.0, -0.4], [0.3, -0.4, 1.0]])
MOTION = Odometry(Pose(0.6, 0.05, 0.25), NOISE**2 * np.array([[1.0, 0.2, 0.1], [0.2, 0.5, 0.1], [0.1, 0.1, 0.3]]))
POINT_COV = NOISE**2 * np.array([[1.0, 0.4], [0.4, 2.0]])
WALL_COV = NOISE**2 * np.array([[0.3, 0.2], [0.2, 1.0]])
# The laws hold for the converged solution, and every match here is correct.
CONVERGED = ISAM2Config(relinearize_threshold=1e-9, iterations=5, undo_probability=1.0)


@dataclass(frozen=True, eq=False)
class World:
    """Landmarks around the start."""

    label: str
    landmarks: Array
    """(n, 2) x, y of a point, alpha, d of a wall, world frame; m and rad"""
    kinds: tuple[Kind, ...]
    """n"""

    @property
    def needs_walls(self) -> bool:
        """Whether one of the landmarks is a wall."""
        return Kind.WALL in self.kinds

    def observation(self, i: LandmarkId, z: Array, cov: Array | None = None) -> Observation:
        """An observation z (2,) of what landmark i is."""
        is_wall = self.kinds[i] == Kind.WALL
        cov = cov if cov is not None else WALL_COV if is_wall else POINT_COV
        z = np.array([wrap_angle(float(z[0])), z[1]]) if is_wall else z
        return Observation(self.kinds[i], z, cov, (-1.0, 1.0) if is_wall else (0.0, 0.0))

    def sight(self, pose: Pose, ids: Iterable[LandmarkId], rng: np.random.Generator) -> dict[LandmarkId, Observation]:
        """Noisy observations of landmarks from a pose."""
        observations = {}
        for i in ids:
            exact = self.observation(i, to_robot(pose.array(), self.landmarks[i], self.kinds[i] == Kind.WALL))
            observations[i] = self.observation(i, exact.z + np.linalg.cholesky(exact.cov) @ rng.standard_normal(2))
        return observations


_POINTS = np.array([[7.0, -1.5], [3.0, 0.0], [6.0, -5.0]])
# Normals towards the robot. The second wall's angle in the robot's frame passes a half turn on the drive.
_WALLS = np.array([[0.3, -3.0], [-2.3, -5.5], [1.7, -7.0]])
POINTS = World("points", _POINTS, (Kind.CORNER, Kind.END, Kind.CORNER))
WALLS = World("walls", _WALLS, (Kind.WALL,) * 3)
BOTH = World("points and walls", np.vstack([_POINTS[:2], _WALLS[:2]]), (*POINTS.kinds[:2], *WALLS.kinds[:2]))
WORLDS = (POINTS, WALLS, BOTH)


def make(part: Part, start: Pose = START, start_cov: Array = START_COV, isam2: ISAM2Config = CONVERGED) -> Estimator:
    """A new estimator at a start with covariance `start_cov` (3, 3); the smoother is made with `isam2`."""
    factory = ESTIMATORS.load(part) if isinstance(part, str) else part
    return make_estimator(factory, start, start_cov, isam2 if options_class(factory) is ISAM2Config else None)


def fed(estimator: Estimator, log: Iterable[tuple[Odometry, Mapping[LandmarkId, Observation]]]) -> Estimator:
    """The estimator after the inputs of a drive."""
    for odometry, observations in log:
        estimator.predict(odometry)
        estimator.update(observations)
    return estimator


@cache
def drive(world: World, steps: int) -> tuple[Log, Pose]:
    """The log of a drive of `steps` updates, and the true pose at its end.

    The first two updates see all landmarks but the last, later ones two or all of them.
    """
    rng = np.random.default_rng(7)
    true = Pose.from_array(START.array() + np.linalg.cholesky(START_COV) @ rng.standard_normal(3))
    count, log = len(world.kinds), []
    for k in range(steps):
        error = np.linalg.cholesky(MOTION.cov) @ rng.standard_normal(3)
        true = true @ MOTION.motion @ Pose.from_array(error)
        ids = range(count - 1) if k < 2 else range(count) if k % 3 else [k % count, (k + 1) % count]
        log.append((MOTION, world.sight(true, list(ids), rng)))
    return log, true


def driven(part: Part, world: World, steps: int = 6, unseen: Collection[LandmarkId] = ()) -> Estimator:
    """An estimator after the drive, on which the landmarks `unseen` are not observed."""
    log = [(motion, {i: s for i, s in seen.items() if i not in unseen}) for motion, seen in drive(world, steps)[0]]
    return fed(make(part), log)


def joint_state(estimator: Estimator) -> tuple[Estimate, Array]:
    """The estimate and the joint covariance of pose and all landmarks."""
    estimate = estimator.estimate()
    return estimate, estimator.joint_covariance(estimate.ids.tolist())


def state_of(estimator: Estimator) -> Posterior:
    """The estimator's own posterior, of pose and all landmarks."""
    estimate, joint = joint_state(estimator)
    angles = np.array([False, False, True, *(flag for wall in estimate.walls for flag in (bool(wall), False))])
    return Posterior(estimate.ids.tolist(), np.append(estimate.pose.array(), estimate.landmarks), joint, angles)


def marginal(posterior: Posterior, ids: Sequence[LandmarkId]) -> Posterior:
    """A posterior of the pose and these landmarks alone."""
    rows = [0, 1, 2, *(3 + 2 * posterior.ids.index(i) + n for i in ids for n in (0, 1))]
    return Posterior([*ids], posterior.mean[rows], posterior.cov[np.ix_(rows, rows)], posterior.angles[rows])


def assert_agrees(found: Estimator | Posterior, reference: Posterior, tolerance: float = TOLERANCE) -> None:
    """Assert that mean and covariance agree with the reference in every direction, relative to its sigma there."""
    state = found if isinstance(found, Posterior) else state_of(found)
    equal("landmarks", state.ids, reference.ids)
    root = np.linalg.cholesky(reference.cov)
    error = state.mean - reference.mean
    error[reference.angles] = wrap_angle(error[reference.angles])
    ratios = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, state.cov).T))
    low, high = float(ratios[0]), float(ratios[-1])
    text = f"covariance: found {low:.6g} to {high:.6g} times the variance of the reference"
    assert low > 1.0 - tolerance and high < 1.0 + tolerance, f"{text}, allowed: 1 within {tolerance:.3g}"
    at_most("mean, in sigma from the reference", float(np.linalg.norm(np.linalg.solve(root, error))), tolerance)


def assert_same(found: Estimator, reference: Posterior) -> None:
    """Assert that an estimator's posterior is the reference but for rounding."""
    assert_agrees(found, reference, ROUNDING)


def assert_unchanged(estimator: Estimator, before: Posterior, rows: Array) -> None:
    """Assert that posterior and trajectory (K, 3) of an estimator are those of before but for rounding."""
    assert_same(estimator, before)
    agree("trajectory", estimator.trajectory(), rows, atol=ROUNDING * NOISE)


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
    return np.asarray(block_diag(np.array(cov), 0.01 * np.eye(1)))


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
        for estimator in (pieces, queried):
            estimator.predict(piece)
        queried.estimate()
    once.predict(folded)
    seen = world.sight(drive(world, 6)[1] @ folded.motion, [0, len(world.kinds) - 1], np.random.default_rng(5))
    for after in ({}, seen):
        for estimator in (once, queried, pieces):
            estimator.update(after)
            assert_unchanged(estimator, state_of(once), once.trajectory())


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
    turn = block_diag(rotation(moved.theta), np.eye(1))
    start, start_cov = moved @ START, turn @ START_COV @ turn.T
    assert_agrees(fed(make(part, start, start_cov), log), batch_posterior(log, start, start_cov))


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
    """One or all. The marginal stays, or their observations are removed as well, as by a smoother."""
    last = len(world.kinds) - 1
    for gone in ([last], [*range(last + 1)]):
        estimator = driven(part, world)
        before, rows = state_of(estimator), estimator.trajectory()
        left = [i for i in before.ids if i not in gone]
        estimator.forget(gone)
        try:
            assert_same(estimator, marginal(before, left))
        except AssertionError:
            assert_agrees(estimator, state_of(driven(part, world, unseen=gone)), 1e-3)
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


@LAWS.law(2)
def the_trajectory_has_one_row_per_update_and_starts_empty(part: Part) -> None:
    """Updates without observations add rows, too: the poses of odometry alone."""
    estimator, pose, rows = make(part), START, []
    equal("shape of the trajectory", estimator.trajectory().shape, (0, 3))
    for k in range(120):
        if k % 3:
            estimator.predict(MOTION)
            pose = pose @ MOTION.motion
        estimator.update({})
        rows.append(pose.array())
    agree("trajectory", estimator.trajectory(), np.array(rows), atol=1e-9)
    estimator.update(POINTS.sight(pose, range(3), np.random.default_rng(2)))
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
    equal("walls", estimate.walls.tolist(), [world.kinds[i] == Kind.WALL for i in estimate.ids])
    alpha = estimate.landmarks[estimate.walls, 0]
    assert ((alpha >= -math.pi) & (alpha < math.pi)).all(), f"found angles {alpha.tolist()}, allowed: [-pi, pi)"
