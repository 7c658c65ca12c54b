"""Rigid bodies in the plane that collide: convex polygons, discs and straight boundaries."""
