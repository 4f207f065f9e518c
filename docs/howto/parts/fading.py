"""An estimator of your own: the report's filter with motion noise that is multiplied by a factor."""

from dataclasses import dataclass

from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.ekf import EKF


class Fading(EKF):
    """Trusts the wheels less than they say: for robots that slip."""

    @dataclass(frozen=True)
    class Options:
        """Flags `--estimator-options.gain 1.5`, or a table `[estimator_options]`."""

        gain: float = 1.0
        """Factor of the motion's covariance."""

    def __init__(self, start, start_cov, options):
        super().__init__(start, start_cov)
        self.gain = options.gain

    def predict(self, odometry):
        super().predict(Odometry(odometry.motion, self.gain * odometry.cov))
