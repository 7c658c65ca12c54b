"""The table in the frame: its region, edges, cushion noses and type, and the camera that sees it."""
