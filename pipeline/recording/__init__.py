"""The recording of a run for the rerun viewer: layers of picture, plan, plots and words on one timeline."""
