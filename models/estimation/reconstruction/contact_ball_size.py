"""Ball size that the contacts of a shot show, and whether it contradicts the size with which the shot was fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable

from models.core.fit_result import Parameter
from models.core.scene import BallSize, Scene, find_contradictions
from models.estimation.joint_fit.prior_residuals import DIAMETER_SIGMA
from models.physics.billiards.nominal_ball_size import format_contradiction

# Distance at which balls touch over two radii of the table's balls.
FACTOR_NAME = "ball_size.factor"
# Share of the prior's standard deviation above which the contacts do not identify the factor: below it they hold more
# information than the prior. One contact alone rarely does, and its place may be wrong.
MAX_PRIOR_SHARE = 0.7
# Relative systematic standard deviation of the estimate. On nine clips with known balls and enough contacts the errors
# are then 0.6 standard deviations (root mean square) and at most 1.6.
CONTACT_FLOOR = 0.015


def describe_ball_factor(factor: float, sigma: float) -> Parameter:
    """Describe the fitted factor on the distance of touching balls.

    Args:
        factor: Estimate, with its prior.
        sigma: Standard deviation of the estimate, with its prior.

    Returns:
        The parameter of a fit.
    """
    return Parameter(FACTOR_NAME, factor, sigma, "", sigma > MAX_PRIOR_SHARE * DIAMETER_SIGMA)


def estimate_contact_ball_size(parameters: Iterable[Parameter], radius: float) -> BallSize | None:
    """Estimate the ball size from contacts alone, without the prior that ties it to the other estimates.

    Args:
        parameters: Parameters of a fit.
        radius: Radius of the table's balls, m.

    Returns:
        The estimate; None where the contacts do not identify it.
    """
    factor = next((p for p in parameters if p.name == FACTOR_NAME), None)
    if factor is None or factor.prior_only or not 0 < factor.sigma < DIAMETER_SIGMA:
        return None
    information, prior = factor.sigma**-2, DIAMETER_SIGMA**-2
    value = (factor.value * information - prior) / (information - prior)
    if value <= 0:
        return None
    return BallSize(radius * value, radius * math.hypot((information - prior) ** -0.5, CONTACT_FLOOR), "contacts")


def warn_of_contact_ball_size(parameters: Iterable[Parameter], scene: Scene) -> tuple[str, ...]:
    """Return a warning if the contacts contradict the nominal ball size; empty otherwise.

    A contradiction between the nominal size and the images is a warning of the scene already.

    Args:
        parameters: Parameters of a fit.
        scene: Table with the estimates of the ball size.
    """
    contacts = estimate_contact_ball_size(parameters, scene.table.ball_radius)
    if contacts is None or find_contradictions(scene.ball_size_estimates):
        return ()
    nominal = [estimate for estimate in scene.ball_size_estimates if estimate.source != "image"]
    pairs = find_contradictions([*nominal, contacts])
    return tuple(format_contradiction(*pair, scene.table.name) for pair in pairs)
