"""Particles joined by springs, dampers and rods: the mass-spring-damper model of Chen 2022, eqs 1 to 9."""
