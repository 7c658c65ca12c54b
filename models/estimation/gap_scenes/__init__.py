"""The scenes that the diagnosis of the sim-to-real gap can analyse, behind one interface."""
