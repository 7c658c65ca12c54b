"""Parts that several benchmarks share: run folders, rows in files, the machine."""
