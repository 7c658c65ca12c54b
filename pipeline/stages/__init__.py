"""The stages of a run, one file each: a few lines of wiring around the packages below."""
