"""Latent inference of a mass-spring-damper system from coordinates alone."""
