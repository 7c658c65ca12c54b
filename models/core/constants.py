"""Constants of nature that several scenes share."""

GRAVITY = 9.81
"""Acceleration of free fall, m/s^2: a round value between those at the equator (9.780) and at the poles (9.832)."""
