"""Methods that learn a motion from its coordinates: the simulator of Chen 2022, extensions and competing networks.

The comparison of the methods lives in `pipeline.experiments.thesis`; the neural residual of the physics in
`models.estimation.neural_residual`.
"""
