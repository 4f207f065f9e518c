"""Observations that name their landmark, as a camera's of barcodes do: corrected for the errors of their sensor."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.parts import NEEDS_FILTER
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.sensor import Sensor, sensor_prior
from sixthsense.slam.estimators import Estimate, Estimator, Filter

SCALE_SIGMA = 0.03
"""of the sensor's scale error, as by the size of a barcode. It is not estimated: beside wheels of unknown radius
nothing tells it, so that it only adds to the covariance."""


class SensorCalibration:
    """Corrects observations for their sensor's errors, and reports the uncertainty of its scale."""

    def __init__(self, config: Config, estimator: Estimator, start: Pose) -> None:
        """Raises InputError for an estimator that cannot estimate the sensor."""
        if not isinstance(estimator, Filter):
            raise InputError("calibrate_sensor", f"found true with {config.estimator}", NEEDS_FILTER)
        estimator.calibrate(sensor_prior())
        self._start, self._estimator = start, estimator
        self._scale_variance = SCALE_SIGMA**2

    def sensor(self) -> ParameterEstimate[Sensor] | None:
        """The sensor's parameters."""
        return self._estimator.calibration(Sensor)

    def corrected(self, observations: Mapping[LandmarkId, Observation]) -> Mapping[LandmarkId, Observation]:
        """Observations as the present parameters have them."""
        sensor = self.sensor()
        if sensor is None:
            return observations
        return {i: observation.with_sensor(sensor.values) for i, observation in observations.items()}

    def reported(self, estimate: Estimate) -> Estimate:
        """The estimate with the uncertainty of the scale, which no observation can reduce.

        The map is as large as the sensor sees it. A wrong scale moves all away from the start, or towards it.
        """
        cov = estimate.pose_cov.copy()
        cov[:2, :2] += self._of_scale(estimate.pose.position)
        return dataclasses.replace(estimate, pose_cov=cov)

    def reported_joint(self, estimate: Estimate, cov: Array) -> Array:
        """`cov` (3 + 2n, 3 + 2n) of the pose and all landmarks, which are points, with the same uncertainty."""
        places = np.concatenate([estimate.pose.position, estimate.landmarks.ravel()])
        index = np.delete(np.arange(len(cov)), 2)
        out = cov.copy()
        out[np.ix_(index, index)] += self._of_scale(places)
        return out

    def _of_scale(self, places: Array) -> Array:
        """(2k, 2k) covariance of k places (2k,), world frame, by the scale."""
        offset = places - np.tile(self._start.position, len(places) // 2)
        return self._scale_variance * np.outer(offset, offset)
