"""Effects of the camera: they change the measurement, not the motion.

The code of those that shift places is in `models.physics.billiards.simulation.parametrised_shot.distort_places`, the
code of those that shift times (`rolling_shutter`, `dropped_frames`) in `models.estimation.whole_shot.shot_windows`.
"""
