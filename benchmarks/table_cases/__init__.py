"""Cases and rivals of `real_tables`."""
