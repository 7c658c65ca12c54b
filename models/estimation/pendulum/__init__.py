"""The fit of a double pendulum to measured angles."""
