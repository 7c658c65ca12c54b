"""Hypotheses of courts: a table that is seen flat stays possible though its lines are a px off; other shapes do not."""

import numpy as np

from models.core.scene import apply_homography
from models.sports.sport_catalogue import find_sports
from video.calibration.court_hypotheses import SAME_COURT, _match_lines, _possible_ratios, _Quads, _unit_square_to

TABLE = find_sports()["table-tennis"]
# px about the image centre, of a rendered table eight metres away whose camera is a metre above it: the corners of its
# outer lines, near and far, left and right, as the lines were found and as they are.
FOUND = np.array([[[-295.9, 40.1], [234.4, 65.5]], [[-203.6, -11.9], [249.7, 3.7]]])
TRUE = np.array([[[-296.5, 41.8], [233.9, 66.4]], [[-200.8, -12.4], [249.1, 4.8]]])


def find_nearest(corners):
    """Return how far, px, the best hypothesis from lines with these corners is from them; infinite without any."""
    quads = _Quads(corners[None], _unit_square_to(corners[None]))
    edge = 0.01
    x, y = (edge, TABLE.length - edge), (edge, TABLE.width - edge)
    places = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
    ring = corners.reshape(4, 2)[[0, 1, 3, 2]]
    found = [
        apply_homography(matrix, places)[turn]
        for matrix in _match_lines(quads, *_possible_ratios(quads, 1280), TABLE)
        for turn in SAME_COURT
    ]
    return min((np.abs(one - ring).max() for one in found), default=np.inf)


def test_a_table_seen_flat_is_proposed_though_its_lines_are_a_px_off():
    assert find_nearest(TRUE) < 0.1
    assert find_nearest(FOUND) < 0.1


def test_a_quadrangle_of_another_shape_is_not_proposed():
    assert find_nearest(FOUND + np.array([[[150.0, 0.0]], [[0.0, 0.0]]])) == np.inf
