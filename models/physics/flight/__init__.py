"""Flight of the balls and shuttles of court sports."""
