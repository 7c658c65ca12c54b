"""The experiments of Chen 2022: every method on the same withheld frames, with tables, figures and a page."""
