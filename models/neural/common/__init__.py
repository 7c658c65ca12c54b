"""Parts that all learned methods share: interface, perceptron, scaling, integration steps, training, splines."""
