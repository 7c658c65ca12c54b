"""Effects of the camera: they change the measurement, not the motion.

Their equations are in `models.physics.billiards.image_distortion`.
"""
