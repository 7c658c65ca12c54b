"""Log of the passes of a fit: the cost before and after each, for `trueroll run --debug`."""

from __future__ import annotations

import logging

from models.core.contact_graph import JointSolution
from models.estimation.structure_search.ball_encounters import total_cost

logger = logging.getLogger("trueroll.fit")


def log_pass(name: str, before: JointSolution, after: JointSolution, prices: tuple[float, float]) -> JointSolution:
    """Log the cost and the contacts before and after a pass.

    Args:
        name: Name of the pass.
        before: Solution before it.
        after: Solution after it.
        prices: chi2 that contacts with a cause and without cost.

    Returns:
        The solution after it.
    """
    if logger.isEnabledFor(logging.DEBUG):
        costs = [total_cost(one, prices) for one in (before, after)]
        counts = [len(one.graph.contacts) for one in (before, after)]
        change = "unchanged" if after is before else f"{costs[1]:.1f} with {counts[1]}"
        logger.debug("%-26s cost %.1f with %d contacts -> %s", name, costs[0], counts[0], change)
    return after
