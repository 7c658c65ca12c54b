"""Billiards shots as windows of the multiple-shooting fit: free paths, cushion chains, whole shots, whole tables.

The generic optimizer lives in `multiple_shooting`, the equations of motion in `models.physics.billiards`.
"""
