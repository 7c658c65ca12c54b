"""Every method that learns a motion, in the order of tables. Imports torch: import it where it is used."""

from __future__ import annotations

from models.curves import CURVES
from models.neural.chosen import Chosen
from models.neural.constraint import CONSTRAINT_NET
from models.neural.hamiltonian import HAMILTONIAN, SEPARABLE
from models.neural.interaction import INTERACTION
from models.neural.method import Method
from models.neural.second_order import PLAIN_FLOW, SECOND_ORDER
from models.neural.simulator import CORRECTED, EULER, EXTRAPOLATION, FOURIER, PRINTED, RUNGE_KUTTA, SMOOTH

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
