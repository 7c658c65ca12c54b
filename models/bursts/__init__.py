"""Balls that lie together and are hit: what follows within a picture or two is played, not told one by one."""
