"""Sports over a net, one module each: court, net, object and where a landing is good.

A module defines `SPORT`; `find_sports` finds it, and everything else follows from it.
"""
