"""The blind check of the diagnosis: worlds with a withheld effect, measurements with a known one."""
