"""The torch networks, their targets and losses."""
