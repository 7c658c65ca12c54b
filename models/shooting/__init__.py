"""Multiple shooting with Levenberg-Marquardt, over any model that offers states, numbers and slopes."""
