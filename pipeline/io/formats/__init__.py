"""Formats of tracks that other programs read and write, by family; `track_format` finds them."""
