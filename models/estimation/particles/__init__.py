"""Particles with unknown physics: the model that explains their coordinates, interpolation and prediction.

The models themselves live in `springs`, `rigid_bodies` and `models.neural.common.method_interface`.
"""
