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
        """If `config` wants it, otherwise all stays as it is; InputError for an estimator that cannot do it."""
        self._start, self._scale_variance = start, SCALE_SIGMA**2 if config.calibrate_sensor else 0.0
        self._filter = estimator if isinstance(estimator, Filter) else None  # once: the check takes a tenth of a tick
        if config.calibrate_sensor:
            if self._filter is None:
                raise InputError("calibrate_sensor", f"found true with {config.estimator}", NEEDS_FILTER)
            self._filter.calibrate(sensor_prior())

    def sensor(self) -> ParameterEstimate[Sensor] | None:
        """The sensor's parameters, if they are estimated."""
        return None if self._filter is None else self._filter.calibration(Sensor)

    def corrected(self, observations: Mapping[LandmarkId, Observation]) -> Mapping[LandmarkId, Observation]:
        """Observations as the present parameters have them."""
        sensor = self.sensor()
        if sensor is None:
            return observations
        return {i: observation.with_sensor(sensor.values) for i, observation in observations.items()}

    def reported(self, estimate: Estimate) -> Estimate:
        """The estimate with the uncertainty of the scale, as of `reported_joint`."""
        return dataclasses.replace(estimate, pose_cov=self.reported_joint(estimate.pose.position, estimate.pose_cov))

    def reported_joint(self, places: Array, cov: Array) -> Array:
        """`cov` (1 + k, 1 + k) of the pose and of points with the uncertainty of the scale.

        No observation can reduce it: the map is as large as the sensor sees it. A wrong scale moves all away from the
        start, or towards it. `places` (k,) are the x and y of all, world frame; the heading is third in `cov`.
        """
        offset = np.insert(places - np.tile(self._start.position, len(places) // 2), 2, 0.0)
        return np.asarray(cov + self._scale_variance * np.outer(offset, offset))
