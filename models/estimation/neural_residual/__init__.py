"""A small neural network that corrects the cloth and cushion models of billiards, and its training."""
