"""The learnt methods, one file each."""
