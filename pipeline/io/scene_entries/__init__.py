"""Entries of scene.json that stand for one value; they read no files."""
