"""Where a simulator and the world part, which effect is missing, and how far the gap shrinks with it."""
