"""Networks that learn a motion from its coordinates: the simulator of Chen 2022, its extensions and its rivals."""
