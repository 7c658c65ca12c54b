"""Parts that all learnt methods share: interface, perceptron, scaling, integration steps, training, splines."""
