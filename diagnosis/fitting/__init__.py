"""Fits of one scene under a hypothesis: windows, noise, residuals, and the gap on held-out shots."""
