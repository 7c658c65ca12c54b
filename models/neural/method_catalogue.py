"""Every method that learns a motion, in the order of tables. Imports torch: import it where it is used."""

from __future__ import annotations

from models.neural.common.method_interface import Method
from models.neural.common.spline_methods import CURVES
from models.neural.method_selection import Chosen
from models.neural.networks.constraint_net import CONSTRAINT_NET
from models.neural.networks.hamiltonian_network import HAMILTONIAN, SEPARABLE
from models.neural.networks.interaction_network import INTERACTION
from models.neural.networks.neural_runge_kutta import (
    CORRECTED,
    EULER,
    EXTRAPOLATION,
    FOURIER,
    PRINTED,
    RUNGE_KUTTA,
    SMOOTH,
)
from models.neural.networks.second_order_network import PLAIN_FLOW, SECOND_ORDER

THESIS: tuple[Method, ...] = (EULER, RUNGE_KUTTA, PRINTED, CORRECTED, EXTRAPOLATION)
"""Chen 2022, 512 x 512 x 512."""
CHOSEN = Chosen(
    "chosen net",
    tuple((method, effort) for method in (SMOOTH, SECOND_ORDER, HAMILTONIAN) for effort in (1.0, 0.2, 0.05)),
)
BETTER: tuple[Method, ...] = (SMOOTH, FOURIER, SECOND_ORDER, CHOSEN)
RIVALS: tuple[Method, ...] = (PLAIN_FLOW, HAMILTONIAN, SEPARABLE, INTERACTION, CONSTRAINT_NET)
NETWORKS: tuple[Method, ...] = (*THESIS, *BETTER, *RIVALS)
METHODS: tuple[Method, ...] = (*CURVES, *NETWORKS)
