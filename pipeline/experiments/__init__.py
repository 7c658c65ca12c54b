"""Experiments that check the program itself: the thesis reproduced, the diagnosis tested blind."""
