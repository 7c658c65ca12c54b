"""Commands that look after the cache and the stages of the chain."""
