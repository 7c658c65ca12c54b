"""Bodies that slide on a plane."""
