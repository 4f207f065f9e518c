"""A place search of your own: the places that look most like what is seen, where the robot is expected there."""

import numpy as np

from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.known_places import of_last_metres, surfaces_around
from sixthsense.slam.scans.place_search import Candidate, distinct
from sixthsense.slam.scans.places import appearance


class Alike:
    """Compares what places look like, and searches no pose: for robots with good odometry."""

    def propose(self, query):
        keys = of_last_metres(query.scans.travelled_m, query.key)
        poses = query.scans.poses
        seen, _ = surfaces_around(query.scans, keys, between(poses[query.key], poses[keys]))
        if not len(seen) or not len(query.places.anchors):
            return []
        alike = np.clip(query.places.looks @ appearance(seen), 0.0, 1.0)
        found = []
        for place in np.argsort(-alike, kind="stable")[:3].tolist():
            pose = compose(query.places.anchors[place], query.expected.poses[place])
            found.append(Candidate(pose, float(alike[place]), query.places.surroundings(place)))
        return distinct(found)
