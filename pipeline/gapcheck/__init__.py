"""The blind check of the diagnosis: worlds that withhold an effect, and measurements whose effect is known."""
