"""The experiments of Chen 2022, run again: every method side by side, tables, plots and a page."""
