"""Cases, truth, scores and tables of the stress test."""
