"""Numerical methods without billiards: least squares, robust statistics, roots, splines, integrators, executors.

Physical models live in `models.physics`, statistical estimation in `models.estimation`.
"""
