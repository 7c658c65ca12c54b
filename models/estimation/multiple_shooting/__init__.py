"""Multiple shooting with Levenberg-Marquardt, for any model with start states, shared parameters and derivatives.

Nothing here knows what moves: scenes implement the protocol `ShootingModel` elsewhere (`whole_shot`, `gap_scenes`).
"""
