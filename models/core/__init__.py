"""Values that flow through the program: detections, tracks, events, trajectories, scenes and fits.

Nothing here computes physics or reads files; every package may import it.
"""
