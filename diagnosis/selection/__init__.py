"""Which effects are missing: signatures propose hypotheses, joint refits and cross-shot evidence decide."""
