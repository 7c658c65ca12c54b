"""The scenes of the thesis as series of coordinates with withheld frames."""
