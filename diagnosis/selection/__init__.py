"""Which effects are missing: signatures propose, joint refits decide."""
