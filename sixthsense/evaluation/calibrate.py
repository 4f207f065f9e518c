"""Calibration: drive the robot where the truth is known, and fit the noise that estimators assume (report section 4.1).

Only this step uses the truth, as a calibration with a measuring tape would. The result is a normal configuration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sixthsense.config import AssumedConfig, Config, as_table, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.source import Command
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.evaluation.noise import (
    FEWEST_SAMPLES,
    SIGNIFICANT,
    LandmarkErrors,
    PropagationErrors,
    Sample,
    fit_laser,
    fit_motion,
    landmark_errors,
    propagation_errors,
)
from sixthsense.simulation.scene import check_placement, load_scene
from sixthsense.simulation.world import World

PERIOD_S = 0.5  # duration of a sample, as in the report

_STARTS = 100


@dataclass(frozen=True, slots=True)
class Calibration:
    """Result of a calibration."""

    assumed: AssumedConfig
    """the fitted assumptions"""
    systematic: dict[str, tuple[float, float]]
    """estimate and sigma of each systematic error of the wheels, also of those set to zero"""
    propagation: tuple[PropagationErrors, PropagationErrors]
    """errors of odometry before and after"""
    landmarks: tuple[LandmarkErrors, LandmarkErrors]
    """errors of observations before and after"""


def calibrate(config: Config, samples: int = 100, on_sample: Callable[[], object] | None = None) -> Calibration:
    """Drive the robot of `config` in its scene and fit `assumed` to its noise; `on_sample` is called after each sample.

    Raises InputError for an invalid scene or start, and for too few samples or landmarks.
    """
    if samples < FEWEST_SAMPLES:
        raise InputError("samples", f"found {samples}", f"at least {FEWEST_SAMPLES}")
    world_rng, drive_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
    walls, driven = drive_samples(config, samples, world_rng, drive_rng, on_sample)
    landmarks = true_landmarks(walls)
    # Points have known true positions, so the laser's noise is fitted to them; walls have the same noise.
    config = merge(config, {"features": {"landmarks": "corners"}})
    assumed = config.assumed
    with threadpool_limits(limits=1, user_api="blas"):  # as in the loop, for reproducibility
        motion, systematic = fit_motion(driven, assumed)
        fitted = fit_laser(driven, landmarks, motion, config)
        propagation = propagation_errors(driven, assumed), propagation_errors(driven, fitted)
        observations = (
            landmark_errors(driven, landmarks, assumed, config),
            landmark_errors(driven, landmarks, fitted, config),
        )
    return Calibration(fitted, systematic, propagation, observations)


def drive_samples(
    config: Config,
    samples: int,
    world_rng: np.random.Generator,
    drive_rng: np.random.Generator,
    on_sample: Callable[[], object] | None = None,
) -> tuple[Array, list[Sample]]:
    """Drive with a random speed and a random turn rate to the left in each sample; return the walls and the samples.

    A sample that ends at a wall does not count, and the robot begins again at its start.
    """
    scene, robot = load_scene(config.scene, config.map_unknown), config.robot
    start = Pose(*config.start) if config.start is not None else scene.start
    start = check_placement(scene, start, None, config.region, robot.radius)
    out: list[Sample] = []
    for _ in range(_STARTS):
        world = World(scene.walls, start, robot.radius or scene.radius, config, world_rng, scene.glass)
        tick = world.step(Command())
        while tick is not None and not tick.collided and len(out) < samples:
            began, track = tick, [tick.odometry]
            command = Command(drive_rng.random() * robot.speed, drive_rng.random() * robot.turn_rate)
            # A sample ends at the first scan after its duration, so a slow laser makes longer samples.
            while (tick := world.step(command)) is not None and not tick.collided:
                track.append(tick.odometry)
                if tick.scan is not None and tick.stamp_ns - began.stamp_ns >= round(PERIOD_S * 1e9) - 1000:
                    assert began.truth is not None and tick.truth is not None
                    out.append(Sample(tuple(track), began.truth.inverse() @ tick.truth, tick.truth, tick.scan))
                    if on_sample is not None:
                        on_sample()
                    break
        if len(out) == samples:
            return scene.walls, out
    raise InputError("start", f"the robot touched a wall {_STARTS} times", "a start with room around it")


def as_partial_config(found: Calibration, config: Config) -> dict[str, Any]:
    """The fields set by a calibration as a nested table, the content of a file for `load_config`."""
    assumed = as_table(found.assumed)
    fitted = {name: assumed[name] for name in ("wheel_scale_error", "drift_rad_per_m", "landmark_floor_m", "motion")}
    fitted["laser"] = {name: assumed["laser"][name] for name in ("distribution", "range_m")}
    return {"preset": config.preset, "assumed": fitted}


def summary(found: Calibration) -> list[str]:
    """Lines with the counts, systematic errors, covariances (report eq. 3) and NEES before and after."""
    (odometry, odometry_after), (observations, observations_after) = found.propagation, found.landmarks
    lines = [
        f"propagation: {len(odometry.errors)} samples, mean NEES {odometry.nees.mean():.2f} before, "
        f"{odometry_after.nees.mean():.2f} after; 3 is consistent"
    ]
    for name, (value, sigma) in found.systematic.items():
        kept = "kept" if getattr(found.assumed, name) else f"set to 0: within {SIGNIFICANT:.0f} sigma"
        lines.append(f"{name}: {value:.4f} +- {sigma:.4f}, {kept}")
    lines.append(
        f"landmarks: {len(observations.errors)} observations, mean NEES {observations.mean_nees:.2f} before; "
        f"{len(observations_after.errors)}, {observations_after.mean_nees:.2f} after; 2 is consistent"
    )
    for kind in (Kind.CORNER, Kind.END):
        errors = 1e3 * observations_after.of(kind)
        name = kind.name.lower()
        if len(errors) < 2:
            lines.append(f"{name}: {len(errors)} observations, too few for a covariance")
            continue
        (xx, xy), (_, yy) = errors.T @ errors / len(errors)
        lines.append(
            f"{name}: {len(errors)} observations, covariance with zero mean xx {xx:.1f} xy {xy:.1f} yy {yy:.1f} mm^2"
        )
    return lines


def check_output(file: Path, overwrite: bool) -> None:
    """Raise InputError if `file` or its figure, a PNG of the same name, exists or is not allowed as an output."""
    if file.name in ("", "..") or file.suffix == ".png" or file.is_dir():
        raise InputError("out", f"found {str(file)!r}", "the name of a file, such as noise.toml")
    for one in (file, file.with_suffix(".png")):
        if one.exists() and not overwrite:
            raise InputError("out", f"{one} exists", "a new file, or `overwrite`")
