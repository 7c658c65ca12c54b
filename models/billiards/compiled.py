"""How the physics of billiards is compiled: once for real numbers, once for complex ones.

A law is written once. With float64 it gives the outcome; with complex128 and a step of 1e-30 along the imaginary axis
it gives its derivative, exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X). So it branches on
real parts and has no abs, min or max of what can be complex.

There is no cache on disk: numba keys it by the file of a function alone, and would run yesterday's version of what that
function calls in other files.
"""

from __future__ import annotations

import numba

compiled = numba.njit(error_model="numpy", nogil=True)
"""Decorator. Division by zero gives inf as in numpy, other threads run meanwhile, and sums keep their order."""
