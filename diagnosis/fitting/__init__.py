"""Fits of a scene with some of its effects: windows, noise, residuals, and the gap on hold-out shots. No decisions."""
