"""Which known places are looked into."""

import math

import numpy as np
import pytest

from sixthsense.slam.scans.place_search import ExpectedPoses, likeliest
from sixthsense.slam.scans.places import BINS


class Known:
    """Places at anchors (n, 3), each of which looks like one of some kinds."""

    def __init__(self, anchors, kinds):
        self.anchors, kinds = np.array(anchors), np.array(kinds)
        self.looks = np.zeros((len(kinds), BINS))
        self.looks[np.arange(len(kinds)), kinds] = 1.0


def look_of(kind):
    return np.eye(BINS)[kind]


FAR = [[17.0, -31.0, 0.4], [2.0, 1.0, -0.7], [-11.0, 6.0, 2.9], [40.0, 23.0, 1.3], [-5.0, -9.0, 0.1]]
OFF = [[9.0, 2.0, 0.3], [-1.5, 0.4, 1.0], [0.0, 25.0, -2.0], [-3.0, 3.5, 0.0], [60.0, 1.0, 0.2]]
"""where the scan is expected, in the frames of the anchors of FAR: 9.2, 1.6, 25, 4.6 and 60 m away"""


def test_of_places_that_look_the_same_the_nearest_to_where_the_scan_is_expected_comes_first():
    expected = ExpectedPoses(np.array(OFF), np.full(5, 6.0), np.full(5, 0.2))
    assert likeliest(Known(FAR, [3] * 5), expected, look_of(3)) == [1, 3, 0, 2, 4]


def test_where_nothing_is_known_what_looks_most_alike_comes_first_wherever_it_is():
    places = Known(FAR, [5, 4, 4, 3, 5])
    look = 0.8 * look_of(3) + 0.6 * look_of(4)
    assert likeliest(places, ExpectedPoses.anywhere(5), look) == [3, 1, 2, 0, 4]


def test_places_beside_a_likelier_one_are_not_looked_into_and_eight_are_at_most():
    anchors = [[x, 0.3, 0.1] for x in np.arange(0.0, 60.0, 3.0)]
    chosen = likeliest(Known(anchors, [3] * 20), ExpectedPoses.anywhere(20), look_of(3))
    assert chosen == list(range(0, 16, 2))


def test_a_window_is_the_part_of_a_place_where_the_scan_may_be():
    expected = ExpectedPoses(np.array([[4.0, -3.0, 0.6], [9.3, 0.5, 0.1]]), np.array([0.25, 0.2]), np.array([0.1, 0.1]))
    window = expected.window(0)
    assert window.centre == pytest.approx([3.5, -3.0, 0.6]) and window.half_m == pytest.approx(2.0)
    assert window.half_rad == pytest.approx(0.32)
    assert expected.window(1) is None
    whole = ExpectedPoses.anywhere(3).window(2)
    assert whole.centre == pytest.approx(np.zeros(3)) and whole.half_m == 5.0 and whole.half_rad == math.pi
