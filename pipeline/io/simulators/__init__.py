"""Simulators from outside: files of MuJoCo, functions of Python, and recorded simulations."""
