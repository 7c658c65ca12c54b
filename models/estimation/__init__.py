"""Estimation of motion, contacts and parameters from tracks. One subpackage per method or question."""
