"""A front end of your own: keyframes by odometry alone, which a scan is never looked at for."""

from sixthsense.core.motion import STANDSTILL
from sixthsense.slam.front_end import Finished, Keyframe, is_due


class Wheels:
    """Dead reckoning: what every other front end has to be better than."""

    def __init__(self, setup):
        self.estimator, self.limits = setup.estimator, setup.config.keyframes
        self.pose, self.since, self.keyframes = setup.start, STANDSTILL, 0

    def take(self, evidence):
        if evidence.increment is not None:
            self.since = self.since.then(evidence.increment)
            self.pose = self.pose @ evidence.increment.motion
        is_first = self.keyframes == 0
        if evidence.scan is None or not (is_first or is_due(self.since.motion, self.since, self.limits)):
            return None
        motion, self.since = self.since, STANDSTILL
        self.estimator.predict(motion)
        predicted = self.estimator.estimate()
        self.estimator.update({})
        estimate = self.estimator.estimate()
        self.pose, self.keyframes = estimate.pose, self.keyframes + 1
        return Keyframe(self.keyframes - 1, motion, predicted, estimate)

    def finish(self):
        self.estimator.predict(self.since)
        self.since = STANDSTILL
        return Finished(self.estimator.estimate())
