"""From candidate places of a ball or shuttle in the frames to its flights in space."""
