"""Parameters of wheels and sensor in the state of a filter, between the pose and the landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.sensor import Sensor, SensorEstimate
from sixthsense.core.wheels import WheelEstimate, Wheels
from sixthsense.slam.estimators.base import check_parameters

_NONE = slice(3, 3)


@dataclass(slots=True)
class Parameters:
    """The values that are estimated, and where they are in the state."""

    end: int = 3
    """where the landmarks begin in the state: after the pose, and the parameters"""
    wheels: Wheels | None = None
    of_wheels: slice = field(default_factory=lambda: _NONE)
    sensor: Sensor | None = None
    of_sensor: slice = field(default_factory=lambda: _NONE)

    def add_wheels(self, prior: WheelEstimate, has_begun: bool) -> None:
        """Add the wheels' parameters; RuntimeError if the filter has begun, ValueError for an invalid covariance."""
        check_parameters("wheels", prior, self.wheels is not None or has_begun)
        self.wheels, self.of_wheels = prior.values, self._added(prior.cov)

    def add_sensor(self, prior: SensorEstimate, has_begun: bool) -> None:
        """Add the sensor's parameters; RuntimeError if the filter has begun, ValueError for an invalid covariance."""
        check_parameters("sensor", prior, self.sensor is not None or has_begun)
        self.sensor, self.of_sensor = prior.values, self._added(prior.cov)

    def _added(self, cov: Array) -> slice:
        begin, self.end = self.end, self.end + len(cov)
        return slice(begin, self.end)

    def correct(self, shift: Array) -> None:
        """Add a correction of the state, (3 + p + 2n,)."""
        if self.wheels is not None:
            self.wheels = Wheels.from_array(self.wheels.array() + shift[self.of_wheels])
        if self.sensor is not None:
            self.sensor = Sensor.from_array(self.sensor.array() + shift[self.of_sensor])

    def sensed(self, observations: Mapping[LandmarkId, Observation]) -> Mapping[LandmarkId, Observation]:
        """The observations for the present parameters of the sensor, if they are estimated."""
        if self.sensor is None:
            return observations
        return {i: observation.with_sensor(self.sensor) for i, observation in observations.items()}

    def by_sensor(self, predicted: Array) -> Array:
        """(2, p) minus the Jacobian of a corrected point by the sensor's parameters, at the predicted point (2,).

        At the observed point its noise would be in the Jacobian, which biases the parameters.
        """
        assert self.sensor is not None
        return -self.sensor.jacobian(self.sensor.reported(predicted))
