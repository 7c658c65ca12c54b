"""Values that are measured for players and coaches."""
