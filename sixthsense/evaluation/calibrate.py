"""How noisy the robot is: drive it where the truth is known, and fit what the estimators assume (report section 4.1).

The truth is known in this step alone, as with a measuring tape; what comes out is a configuration like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sixthsense.config import AssumedConfig, Config, as_table, merge
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.landmarks import Kind
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.evaluation.noise import (
    FEWEST_SAMPLES,
    SIGNIFICANT,
    CalibrationError,
    LandmarkErrors,
    PropagationErrors,
    Sample,
    fit_laser,
    fit_motion,
    landmark_errors,
    propagation_errors,
)
from sixthsense.sources.scene import check_placement, load_scene
from sixthsense.sources.world import World

SAMPLES = 100
PERIOD_S = 0.5  # between two samples, as in the report

_MARGIN_M = 0.05  # kept to walls beside the robot's radius
_STARTS = 20
_TRIES = 20  # commands drawn before the robot turns on the spot instead


@dataclass(frozen=True, slots=True)
class Calibration:
    """What the robot's noise turned out to be."""

    assumed: AssumedConfig
    """fitted"""
    samples: int
    """of motion"""
    systematic: dict[str, tuple[float, float]]
    """estimate and sigma of the wheels' systematic errors, kept or not"""
    propagation: tuple[PropagationErrors, PropagationErrors]
    """before and after"""
    landmarks: tuple[LandmarkErrors, LandmarkErrors]
    """before and after"""


def calibrate(config: Config, samples: int = SAMPLES, on_sample: Callable[[], object] | None = None) -> Calibration:
    """Drive `config`'s robot around its scene and fit `assumed` to its noise; `on_sample` is called after each sample.

    Raises SceneError for a scene or a start that will not do, CalibrationError for too few samples or landmarks.
    """
    if samples < FEWEST_SAMPLES:
        raise CalibrationError(f"samples: found {samples}, allowed: at least {FEWEST_SAMPLES}")
    world_rng, drive_rng, ransac_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(3))
    seed = int(ransac_rng.integers(2**31))
    walls, driven = drive_samples(config, samples, world_rng, drive_rng, on_sample)
    landmarks = true_landmarks(walls)
    # The noise of the laser shows best in points whose true place is known; it is that of walls as well.
    config = merge(config, {"features": {"landmarks": "corners"}})
    before = config.assumed
    with threadpool_limits(limits=1, user_api="blas"):  # as in the loop: one seed gives one result, bit for bit
        motion, systematic = fit_motion(driven, before)
        after = fit_laser(driven, landmarks, motion, config, seed)
        moved, saw = (
            [propagation_errors(driven, assumed) for assumed in (before, after)],
            [landmark_errors(driven, landmarks, assumed, config, seed) for assumed in (before, after)],
        )
    return Calibration(after, samples, systematic, (moved[0], moved[1]), (saw[0], saw[1]))


def drive_samples(
    config: Config,
    samples: int,
    world_rng: np.random.Generator,
    drive_rng: np.random.Generator,
    on_sample: Callable[[], object] | None = None,
) -> tuple[Array, list[Sample]]:
    """Drive at random speeds and random turn rates to the left, a new pair every sample; the walls and the samples.

    Whoever measures the truth also sees to it that nothing is touched: commands that would lead too near a wall are
    drawn again, or replaced by a turn on the spot; after a collision all the same the robot is put back to its start.
    """
    scene = load_scene(config.scene)
    start = Pose(*config.start) if config.start is not None else scene.start
    check_placement(scene, start, None, config.region, config.robot.radius)
    assert start is not None  # check_placement has seen to it
    radius_m = config.robot.radius or scene.radius
    out: list[Sample] = []
    for _ in range(_STARTS):
        world = World(scene.walls, start, radius_m, config, world_rng)
        tick = world.step(Command())
        while tick is not None and len(out) < samples:
            assert tick.truth is not None
            began, began_ns, track = tick.truth, tick.stamp_ns, [tick.odometry]
            command = _command(began, scene.walls, radius_m, config, drive_rng)
            # The first scan after half a second; a slower laser makes longer samples.
            while (tick := world.step(command)) is not None and not tick.collided:
                track.append(tick.odometry)
                if tick.scan is not None and tick.stamp_ns - began_ns >= round(PERIOD_S * 1e9) - 1000:
                    break
            if tick is None or tick.collided:
                break
            assert tick.truth is not None and tick.scan is not None
            out.append(Sample(tuple(track), began.inverse() @ tick.truth, tick.truth, tick.scan))
            if on_sample is not None:
                on_sample()
        if len(out) == samples:
            return scene.walls, out
    raise CalibrationError(f"start: the robot touched a wall {_STARTS} times, allowed: a start with room around it")


def _command(pose: Pose, walls: Array, radius_m: float, config: Config, rng: np.random.Generator) -> Command:
    """A command that keeps clear of walls for a sample and its noise; the last resort is a turn on the spot."""
    robot = config.robot
    period_s = max(PERIOD_S, config.laser.period_ticks * robot.control_period_s) + robot.control_period_s
    for _ in range(_TRIES):
        speed, turn_rate = rng.random() * robot.speed, rng.random() * robot.turn_rate
        way_m = 1.5 * speed * period_s
        clear_m = radius_m + _MARGIN_M + 0.2 * way_m
        track = [rk4(pose, speed, turn_rate, 1.5 * period_s * k / 8, period_s / 8).position for k in range(9)]
        if min(float(point_segment_distance(place, walls).min()) for place in track) > clear_m:
            return Command(speed, turn_rate)
    return Command(0.0, (0.2 + 0.8 * rng.random()) * robot.turn_rate)


def as_partial_config(found: Calibration, config: Config) -> dict[str, Any]:
    """The fields that a calibration sets, as a nested table that `load_config` takes once it is a file."""
    laser = {"distribution": found.assumed.laser.distribution, "range_m": found.assumed.laser.range_m}
    table = {
        "wheel_scale_error": found.assumed.wheel_scale_error,
        "drift_rad_per_m": found.assumed.drift_rad_per_m,
        "landmark_floor_m": found.assumed.landmark_floor_m,
        "motion": as_table(found.assumed.motion),
        "laser": laser,
    }
    return {"preset": config.preset, "assumed": table}


def summary(found: Calibration) -> list[str]:
    """What was measured, in lines: counts, systematic errors, covariances (report eq. 3), NEES before and after."""
    (moved, refitted), (saw, sees) = found.propagation, found.landmarks
    lines = [
        f"propagation: {found.samples} samples, mean NEES {moved.nees.mean():.2f} before, "
        f"{refitted.nees.mean():.2f} after; 3 is consistent"
    ]
    for name, (value, sigma) in found.systematic.items():
        kept = "kept" if getattr(found.assumed, name) else f"not kept: within {SIGNIFICANT:.0f} sigma of none"
        lines.append(f"{name}: {value:.4f} +- {sigma:.4f}, {kept}")
    lines.append(
        f"landmarks: {len(saw.errors)} sightings, mean NEES {saw.mean_nees:.2f} before; {len(sees.errors)}, "
        f"{sees.mean_nees:.2f} after; 2 is consistent"
    )
    lines.append(
        f"left out of it: {saw.outside} sightings outside the 99.9 % gate before, {sees.outside} after; "
        f"near no true landmark: {saw.false} before, {sees.false} after"
    )
    for kind in (Kind.CORNER, Kind.END):
        errors = 1e3 * sees.of(kind)
        name = kind.name.lower()
        if len(errors) < 2:
            lines.append(f"{name}: {len(errors)} sightings, too few for a covariance")
            continue
        (xx, xy), (_, yy) = errors.T @ errors / len(errors)
        mean, about = errors.mean(axis=0), np.cov(errors.T)
        lines.append(
            f"{name}: {len(errors)} sightings, covariance with zero mean xx {xx:.1f} xy {xy:.1f} yy {yy:.1f} mm^2"
        )
        lines.append(
            f"{name}: sample mean x {mean[0]:.2f} y {mean[1]:.2f} mm, "
            f"covariance about it xx {about[0, 0]:.1f} xy {about[0, 1]:.1f} yy {about[1, 1]:.1f} mm^2"
        )
    return lines


def check_free(file: Path, overwrite: bool) -> None:
    """Raise CalibrationError for a file that a calibration may not write, or whose figure would lie upon another."""
    if file.name in ("", "..") or file.suffix == ".png" or file.is_dir():
        raise CalibrationError(f"--out: found {str(file)!r}, allowed: a file to be, such as noise.toml")
    for one in (file, file.with_suffix(".png")):
        if one.exists() and not overwrite:
            raise CalibrationError(f"--out: {one} exists, allowed: a new file, or --overwrite")
