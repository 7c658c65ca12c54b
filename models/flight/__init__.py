"""Bodies that fly."""
