"""Synthesis of frames at any time: balls composited at their fitted positions, rotated by their fitted spin."""
