"""A neural correction inside the integrator, where the physics leaves structure."""
