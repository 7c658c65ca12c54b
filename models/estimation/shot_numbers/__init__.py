"""Numbers of a shot for players and coaches, and statistics of a session; what may happen next is in `forecast`."""
