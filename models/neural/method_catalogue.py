"""Catalogue of all methods that learn a motion, in the order of tables.

The module imports torch, which takes seconds; import it inside the function that needs it.
"""

from __future__ import annotations

from models.neural.common.method_interface import MotionMethod
from models.neural.common.spline_methods import CURVES
from models.neural.method_selection import MethodSelection
from models.neural.networks.constraint_net import CONSTRAINT_NET
from models.neural.networks.hamiltonian_network import HAMILTONIAN, SEPARABLE
from models.neural.networks.interaction_network import INTERACTION
from models.neural.networks.neural_runge_kutta import (
    CORRECTED_NET,
    EULER_NET,
    EXTRAPOLATION_NET,
    FOURIER_NET,
    PRINTED_NET,
    RUNGE_KUTTA_NET,
    SMOOTH_NET,
)
from models.neural.networks.second_order_network import PLAIN_FLOW, SECOND_ORDER

THESIS_METHODS: tuple[MotionMethod, ...] = (EULER_NET, RUNGE_KUTTA_NET, PRINTED_NET, CORRECTED_NET, EXTRAPOLATION_NET)
"""Networks of Chen 2022, with three layers of 512."""
SELECTED_NETWORK = MethodSelection(
    "chosen net",
    tuple((method, effort) for method in (SMOOTH_NET, SECOND_ORDER, HAMILTONIAN) for effort in (1.0, 0.2, 0.05)),
)
EXTENSIONS: tuple[MotionMethod, ...] = (SMOOTH_NET, FOURIER_NET, SECOND_ORDER, SELECTED_NETWORK)
COMPETING_METHODS: tuple[MotionMethod, ...] = (PLAIN_FLOW, HAMILTONIAN, SEPARABLE, INTERACTION, CONSTRAINT_NET)
NETWORKS: tuple[MotionMethod, ...] = (*THESIS_METHODS, *EXTENSIONS, *COMPETING_METHODS)
METHODS: tuple[MotionMethod, ...] = (*CURVES, *NETWORKS)
