"""Rigid bodies in the plane that collide: boxes, discs, floors and walls, followed by points that are fixed to them."""
