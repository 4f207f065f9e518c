"""Laws of `start_from`, for estimators that can begin with the landmarks of an earlier run."""

from __future__ import annotations

import numpy as np
from point_world import START, START_COV, assert_same, joint_state, make, sight, step

from laws.reference import corrected
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimator, Filter, LandmarkPrior
from sixthsense.testing import estimators as worlds
from sixthsense.testing.batch import Posterior
from sixthsense.testing.laws import Laws, raises

LAWS = Laws()

Log = list[tuple[Odometry, dict[LandmarkId, Observation]]]


def begun(name: str, prior: LandmarkPrior, start: Pose = START, start_cov: Array = START_COV) -> Filter:
    """A new estimator that begins with the landmarks of an earlier run."""
    estimator = make(name, start, start_cov)
    assert isinstance(estimator, Filter)
    estimator.start_from(prior)
    return estimator


def prior_of(world: worlds.World, rng: np.random.Generator) -> LandmarkPrior:
    """Landmarks of a world with errors drawn from a joint covariance; ids 10, 11, ... ."""
    n = len(world.kinds)
    mixed = rng.standard_normal((2 * n, 2 * n))
    cov = worlds.NOISE**2 * (np.eye(2 * n) + 0.1 * mixed @ mixed.T)
    walls = np.array([kind == Kind.WALL for kind in world.kinds])
    means = world.landmarks + (np.linalg.cholesky(cov) @ rng.standard_normal(2 * n)).reshape(n, 2)
    return LandmarkPrior(10 + np.arange(n), means, walls, cov, ends(means))


def prior_from(estimator: Estimator) -> LandmarkPrior:
    """The landmarks of an estimator for the next run."""
    estimate, joint = joint_state(estimator)
    return LandmarkPrior(estimate.ids, estimate.landmarks, estimate.walls, joint[3:, 3:], ends(estimate.landmarks))


def ends(walls: Array) -> Array:
    """(n, 2, 2) points of walls (n, 2) one metre to either side of their feet."""
    normal = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    along = np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.asarray(walls[:, 1, None, None] * normal[:, None] + np.array([-1.0, 1.0])[:, None] * along[:, None])


def without(prior: LandmarkPrior, ids: list[LandmarkId]) -> LandmarkPrior:
    """The others, with their marginal covariance."""
    kept = np.flatnonzero(~np.isin(prior.ids, ids))
    index = (2 * kept[:, None] + np.arange(2)).ravel()
    cov = prior.cov[np.ix_(index, index)]
    return LandmarkPrior(prior.ids[kept], prior.landmarks[kept], prior.walls[kept], cov, prior.extents[kept])


def state_of(prior: LandmarkPrior, start: Pose, start_cov: Array) -> Posterior:
    """Start and landmarks before the first motion."""
    n = len(prior.ids)
    cov = np.zeros((3 + 2 * n, 3 + 2 * n))
    cov[:3, :3], cov[3:, 3:] = start_cov, prior.cov
    angles = np.array([False, False, True, *(flag for wall in prior.walls for flag in (bool(wall), False))])
    return Posterior(prior.ids.tolist(), np.append(start.array(), prior.landmarks), cov, angles)


@LAWS.law(None, worlds.WORLDS)
def before_any_motion_the_landmarks_are_their_prior_and_independent_of_the_start(
    name: str, world: worlds.World
) -> None:
    prior = prior_of(world, np.random.default_rng(1))
    estimator = begun(name, prior, worlds.START, worlds.START_COV)
    worlds.assert_agrees(estimator, state_of(prior, worlds.START, worlds.START_COV))
    assert np.array_equal(estimator.estimate().walls, prior.walls)
    assert len(estimator.trajectory()) == 0


@LAWS.law(None, worlds.WORLDS)
def the_first_observations_add_their_information_to_the_prior(name: str, world: worlds.World) -> None:
    rng = np.random.default_rng(2)
    prior = prior_of(world, rng)
    estimator = begun(name, prior, worlds.START, worlds.START_COV)
    seen = {10 + i: s for i, s in world.sight(worlds.START, range(len(world.kinds) - 1), rng).items()}
    expected = corrected(state_of(prior, worlds.START, worlds.START_COV), seen)
    estimator.update(seen)
    worlds.assert_agrees(estimator, expected)


@LAWS.law()
def landmarks_known_exactly_stay_where_they_are(name: str) -> None:
    prior = prior_of(worlds.POINTS, np.random.default_rng(3))
    prior = LandmarkPrior(prior.ids, prior.landmarks, prior.walls, np.zeros_like(prior.cov), prior.extents)
    estimator = begun(name, prior, worlds.START, worlds.START_COV)
    for _ in range(3):
        estimator.predict(worlds.MOTION)
        estimator.update({10: Observation(Kind.CORNER, np.array([1.0, 0.5]), np.eye(2) * 0.01)})
    assert np.allclose(estimator.estimate().landmarks, prior.landmarks, atol=1e-4)


@LAWS.law()
def a_new_landmark_beside_those_of_the_prior_is_added_after_them(name: str) -> None:
    prior = prior_of(worlds.BOTH, np.random.default_rng(3))
    estimator = begun(name, prior, worlds.START, worlds.START_COV)
    estimator.predict(worlds.MOTION)
    estimator.update({3: Observation(Kind.END, np.array([1.0, 0.5]), np.eye(2) * 0.01)})
    estimate, joint = joint_state(estimator)
    assert estimate.ids.tolist() == [*prior.ids.tolist(), 3]
    assert np.allclose(joint[3:-2, 3:-2], prior.cov, rtol=1e-3, atol=1e-2 * worlds.NOISE**2)


@LAWS.law(None, worlds.WORLDS)
def a_forgotten_landmark_leaves_the_marginal_of_the_others(name: str, world: worlds.World) -> None:
    prior = prior_of(world, np.random.default_rng(5))
    estimator = begun(name, prior, worlds.START, worlds.START_COV)
    estimator.forget([11])
    reference = state_of(without(prior, [11]), worlds.START, worlds.START_COV)
    worlds.assert_agrees(estimator, reference)
    seen = {10 + i: s for i, s in world.sight(worlds.START, [0, 2], np.random.default_rng(6)).items()}
    estimator.update(seen)
    worlds.assert_agrees(estimator, corrected(reference, seen))
    estimator.forget([10])
    assert estimator.estimate().ids.tolist() == without(prior, [10, 11]).ids.tolist()


@LAWS.law()
def a_late_or_invalid_prior_map_is_refused(name: str) -> None:
    prior = prior_of(worlds.POINTS, np.random.default_rng(0))
    moved, seen = make(name), make(name)
    moved.predict(step())
    seen.update(sight(START, [0], np.random.default_rng(0)))
    read = make(name)
    read.predict(step())
    read.estimate()
    for estimator in (moved, read, seen, begun(name, prior)):
        assert isinstance(estimator, Filter)
        with raises(RuntimeError, "start_from"):
            estimator.start_from(prior)
    one = np.array([10, 10, 12])
    for ids, means, cov in (
        (one, prior.landmarks, prior.cov),
        (prior.ids, prior.landmarks * np.nan, prior.cov),
        (prior.ids, prior.landmarks, -prior.cov),
        (prior.ids, prior.landmarks, prior.cov[:4, :4]),
    ):
        fresh = make(name)
        before = joint_state(fresh)
        assert isinstance(fresh, Filter)
        with raises(ValueError, "prior"):
            fresh.start_from(LandmarkPrior(ids, means, prior.walls, cov, prior.extents))
        assert_same(before, joint_state(fresh))
