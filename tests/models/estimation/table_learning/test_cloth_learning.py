"""Free paths of a shot, from which the cloth is learned."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, JointSolution, Segment, layout_parameters
from models.core.tracks import Tracks
from models.estimation.joint_fit.pseudo_observations import RUBBER_PRIOR
from models.estimation.table_learning.learn_table import CONTACT_MARGIN, extract_free_segments


def make_straight_path(segments: tuple[Segment, ...], contact: Contact, sigma: float) -> tuple[JointSolution, Tracks]:
    """A ball with one contact, whose time has an error of `sigma` s, and its samples at 50 fps."""
    t = np.arange(60) / 50
    xy = np.stack([0.5 + t, np.full_like(t, 0.7)], axis=1)[:, None]
    graph = ContactGraph(segments, (contact,))
    layout = layout_parameters(graph)
    covariance = 1e-12 * np.eye(layout.size)
    covariance[layout.contact, layout.contact] = sigma**2
    solution = JointSolution(graph, ClothFriction(0.2, 0.01), 1.0, np.zeros(4), RUBBER_PRIOR, 0.0, covariance)
    small = np.full((len(t), 1), 1e-3)
    tracks = Tracks(
        np.arange(len(t)), t, ("cue",), ("white",), xy, xy, small, small, np.zeros_like(xy), small, np.zeros((1, 3))
    )
    return solution, tracks


def test_a_free_path_ends_where_a_break_begins() -> None:
    """The contact of a break has the time at which the ball leaves it; its first contact is 0.2 s earlier."""
    solution, tracks = make_straight_path(
        (
            Segment(0, False, None, 0, 0.0, np.array([0.5, 0.7, 1.0, 0, 0, 0, 0, 0])),
            Segment(0, True, 0, None, 0.8, np.array([1.3, 0.7, 0, 0, 0, 0, 0, 0])),
        ),
        Contact("break", 0.8, (0,), (1,), break_start=0.6),
        1e-6,
    )
    (path,) = extract_free_segments(solution, tracks, 0)
    assert path.t[-1] <= 0.6 - CONTACT_MARGIN
    assert path.t[-1] > 0.55


def test_a_free_path_begins_where_its_contact_is_over_for_certain() -> None:
    """A sample before the contact would bend the path; one in ten thousand to a million is before it."""
    start, sigma = 0.3, 0.02
    solution, tracks = make_straight_path(
        (
            Segment(0, True, None, 0, 0.0, np.array([0.5, 0.7, 0, 0, 0, 0, 0, 0])),
            Segment(0, False, 0, None, start, np.array([0.5, 0.7, 1.0, 0, 0, 0, 0, 0])),
        ),
        Contact("strike", start, (0,), (1,)),
        sigma,
    )
    (path,) = extract_free_segments(solution, tracks, 0)
    assert 1e-6 < norm.sf((path.t[0] - start) / sigma) < 1e-4
