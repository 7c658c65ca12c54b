"""Frames at any time: balls placed where the fitted motion puts them, turned as they spin."""
