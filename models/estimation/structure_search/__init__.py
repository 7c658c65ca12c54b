"""Search for missed, misclassified and false contacts in a refined contact graph."""
