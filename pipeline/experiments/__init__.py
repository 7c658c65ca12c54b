"""Experiments that check the program itself: the experiments of Chen 2022, and the blind check of the diagnosis."""
