"""The ball or shuttle of a rally: a small fast object, found by its motion and judged by its look."""
