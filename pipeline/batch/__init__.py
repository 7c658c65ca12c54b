"""A folder of clips: found, run each in a process that may die, one after another or by many workers, and summed up."""
