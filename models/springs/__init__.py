"""Particles, springs, dampers and pins: their motion, and what coordinates alone tell of them."""
