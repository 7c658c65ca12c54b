"""The blind check of the diagnosis: simulators with a withheld effect, and measurements with a known one."""
