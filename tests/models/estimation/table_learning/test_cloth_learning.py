"""Free paths of a shot, from which the cloth is learned."""

from __future__ import annotations

import numpy as np

from models.core.tracks import Tracks
from models.estimation.joint_fit.fit_solution import JointSolution, layout_parameters
from models.estimation.joint_fit.prior_residuals import RUBBER_PRIOR
from models.estimation.segmentation.contact_graph import Contact, ContactGraph, Segment
from models.estimation.table_learning.cloth_learning import CONTACT_MARGIN, extract_free_segments
from models.physics.billiards.cloth.closed_form_motion import ClothFriction


def test_a_free_path_ends_where_a_break_begins() -> None:
    """The contact of a break has the time at which the ball leaves it; its first contact is 0.2 s earlier."""
    t = np.arange(60) / 50
    xy = np.stack([0.5 + t, np.full_like(t, 0.7)], axis=1)[:, None]
    graph = ContactGraph(
        (
            Segment(0, False, None, 0, 0.0, np.array([0.5, 0.7, 1.0, 0, 0, 0, 0, 0])),
            Segment(0, True, 0, None, 0.8, np.array([1.3, 0.7, 0, 0, 0, 0, 0, 0])),
        ),
        (Contact("break", 0.8, (0,), (1,), break_start=0.6),),
    )
    size = layout_parameters(graph).size
    solution = JointSolution(graph, ClothFriction(0.2, 0.01), 1.0, np.zeros(4), RUBBER_PRIOR, 0.0, 1e-12 * np.eye(size))
    sigma = np.full((len(t), 1), 1e-3)
    tracks = Tracks(
        np.arange(len(t)), t, ("cue",), ("white",), xy, xy, sigma, sigma, np.zeros_like(xy), sigma, np.zeros((1, 3))
    )
    (path,) = extract_free_segments(solution, tracks, 0)
    assert path.t[-1] <= 0.6 - CONTACT_MARGIN
    assert path.t[-1] > 0.55
