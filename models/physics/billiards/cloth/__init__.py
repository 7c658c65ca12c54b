"""Motion of one ball on the cloth between contacts: sliding, rolling, resting."""
