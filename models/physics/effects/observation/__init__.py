"""Effects of the camera: they change the measurement, not the motion.

Their equations are in `models.physics.billiards.simulation.parametrised_shot`.
"""
