"""The catalogue of physical and observational effects: one file per effect, in a folder by where it acts.

The equations that an effect switches on live with the scene that they belong to.
"""
