"""Methods that learn a motion from its coordinates: the simulator of Chen 2022, extensions and competing networks.

The comparison of the methods lives in `pipeline.experiments.thesis`; the network that corrects cushions in
`models.physics.billiards.ball_cushion.rebound_correction`.
"""
