"""Inference of rigid bodies and their world from points that are fixed to them.

The simulation lives in `models.physics.rigid_bodies`.
"""
