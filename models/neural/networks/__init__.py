"""Neural networks that learn a motion, one module per published method."""
