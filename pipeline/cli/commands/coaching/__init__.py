"""Commands for players and coaches: a session in numbers, and a shot played otherwise."""
