"""Latent inference of a mass-spring-damper system from coordinates alone.

The equations of motion live in `models.physics.springs`.
"""
