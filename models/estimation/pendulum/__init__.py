"""The fit of a double pendulum to measured angles; its equations of motion live in `models.physics.pendulum`."""
