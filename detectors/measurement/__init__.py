"""Measurements that every detector uses: cloth background, circle fits, motion blur, colour, overlaps."""
