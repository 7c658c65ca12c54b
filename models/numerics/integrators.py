"""The Runge-Kutta method of all fixed steps: Dormand and Prince's of order 8, in 12 stages.

Hairer, Norsett, Wanner 1993, "Solving Ordinary Differential Equations I", section II.5.
"""

from __future__ import annotations

import numpy as np
from scipy import integrate

# (12, 12) weight of the rate of stage l in the state of stage k, l < k.
DOP853_STAGES = np.array(integrate.DOP853.A)
# (12,) weight of the rate of each stage in the step.
DOP853_WEIGHTS = np.array(integrate.DOP853.B)
