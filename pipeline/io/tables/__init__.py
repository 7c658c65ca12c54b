"""Files about a table: places of balls, clip profiles, certificates."""
