"""The recording of a run for the rerun viewer: layers, blueprint, live stream."""
