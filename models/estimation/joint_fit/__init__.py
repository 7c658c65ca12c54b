"""The joint refinement of all segments, contacts and coefficients of a clip."""
