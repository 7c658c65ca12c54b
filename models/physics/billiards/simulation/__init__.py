"""Event-driven simulation of whole shots, with derivatives by everything that a shot depends on."""
