"""Multiple shooting with Levenberg-Marquardt over any model with states, parameters and derivatives."""
