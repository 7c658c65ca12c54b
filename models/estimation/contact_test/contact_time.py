"""The time at which two bodies touched, for a contact that is certain."""

from __future__ import annotations

from models.core.shot import ContactTestResult
from models.estimation.contact_test.contact_moment import PossibleContact
from models.estimation.contact_test.contact_probability import (
    combine_hypotheses,
    fit_contact,
    list_motion_hypotheses,
    require_samples,
    select_inliers,
)


def estimate_contact_time(contact: PossibleContact, t: float) -> ContactTestResult:
    """Estimate when bodies touched that certainly did, near t (s); errors are independent.

    Args:
        contact: The balls and, if any, the cushion.
        t: s.

    Returns:
        The result with the time of contact.

    Raises:
        ValueError: If there are too few samples.
    """
    require_samples(contact)
    is_inlier = select_inliers(contact, t)
    return combine_hypotheses([fit_contact(option, t, is_inlier, 0.0) for option in list_motion_hypotheses(contact)])
