"""The scenes that the diagnosis of the sim-to-real gap can analyse, behind the interface `GapScene`.

The diagnosis itself lives in `diagnosis`, the physics of each scene in `models.physics`.
"""
