"""The experiments of Chen 2022, run again: scenes, every method side by side, tables, plots and a page."""
