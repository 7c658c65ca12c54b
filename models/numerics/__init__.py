"""Numerical methods that are independent of billiards: roots, splines, integrators, compiled loops, executors.

Physical models live in `models.physics`, statistical estimation in `models.estimation`.
"""
