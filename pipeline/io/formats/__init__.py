"""Formats of tracks that other programs read and write, one file each; `track_format` finds them."""
