"""Entries of track folders of sliding and swinging bodies: walls of a plane, and known inputs."""
