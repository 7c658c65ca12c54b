"""When two surfaces meet: the first time a gap that is a polynomial in time closes.

A polynomial is monotone between the roots of its derivative, so its roots are found one by one from those of its
highest derivative down; none can be missed, however fast a ball is, and none is found twice.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled

MOST_DEGREE = 10
"""Squared distance of two quintics."""
GENTLE = 1e-3
"""m/s: surfaces that close more slowly are let sink in by `DEPTH` and are then returned without loss and friction, so
that balls that press on each other, or bounce ever lower, meet a finite number of times."""
DEPTH = 1e-6
"""m."""
STILL = 1e-9
"""m/s: surfaces that lie deeper than `DEPTH` and close more slowly do not meet yet."""
NEVER = np.inf


@compiled
def value(c, degree, t):  # type: ignore[no-untyped-def]
    """Sum of c[k] t^k."""
    total = c[degree]
    for k in range(degree - 1, -1, -1):
        total = total * t + c[k]
    return total


@compiled
def slope(c, degree, t):  # type: ignore[no-untyped-def]
    """Derivative of `value` by t."""
    total = 0.0
    for k in range(degree, 0, -1):
        total = total * t + k * c[k]
    return total


@compiled
def crossing(c, degree, level, low, high):  # type: ignore[no-untyped-def]
    """Where c passes `level` between low and high, where it is monotone and on different sides of it."""
    sign = 1.0 if value(c, degree, high) > level else -1.0
    t = 0.5 * (low + high)
    for _ in range(100):
        miss = value(c, degree, t) - level
        if miss == 0.0:
            break
        if sign * miss > 0.0:
            high = t
        else:
            low = t
        steep = slope(c, degree, t)
        new = t - miss / steep if steep != 0.0 else low
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-16 * abs(t) or new == t:
            break
        t = new
    return t


@compiled
def turning_points(c, degree, length, work):  # type: ignore[no-untyped-def]
    """0, the roots of the derivative of c within (0, length), and length, in work[0]; how many there are."""
    found = work[1]
    found[0], found[1] = 0.0, length
    count = 2
    d = work[2]
    for order in range(degree - 1, 0, -1):  # the derivative of this order is monotone between `found`
        for k in range(degree - order + 1):
            factor = 1.0
            for j in range(k + 1, k + order + 1):
                factor *= j
            d[k] = c[k + order] * factor
        new, made = work[0], 1
        new[0] = 0.0
        before = value(d, degree - order, found[0])
        for k in range(count - 1):
            after = value(d, degree - order, found[k + 1])
            if before * after < 0.0:
                new[made] = crossing(d, degree - order, 0.0, found[k], found[k + 1])
                made += 1
            elif after == 0.0 and k < count - 2:
                new[made] = found[k + 1]
                made += 1
            before = after
        new[made] = length
        count = made + 1
        found[:count] = new[:count]
    work[0, :count] = found[:count]
    return count


@compiled
def meeting(c, degree, length, reach, begin, through, work):  # type: ignore[no-untyped-def]
    """The first time in [begin, length] when surfaces meet, how fast they close, and whether gently; else `NEVER`.

    c (MOST_DEGREE + 1,) is the gap in m where `reach` is 0, else distance^2 - reach^2 of two centres, as powers of
    time. They meet where the gap closes at `GENTLE` or faster; where it closes more slowly, once it is -`DEPTH`.
    `through`: a gap that is closed already has to open first.
    """
    level = -DEPTH if reach == 0.0 else DEPTH * (DEPTH - 2.0 * reach)
    while degree > 1 and c[degree] == 0.0:
        degree -= 1
    count = turning_points(c, degree, length, work)
    for k in range(count - 1):
        low, high = max(work[0, k], begin), work[0, k + 1]
        if high <= low:
            continue
        gap, end = value(c, degree, low), value(c, degree, high)
        if end >= min(gap, 0.0) or (through and gap <= 0.0):
            continue
        t = crossing(c, degree, 0.0, low, high) if gap > 0.0 else low
        closing = speed(c, degree, reach, t)
        if closing >= GENTLE:
            return t, closing, False
        deep = level
        if gap <= level:
            if closing > STILL:
                return t, closing, True
            deep = gap - (DEPTH if reach == 0.0 else 2.0 * reach * DEPTH)
        if end <= deep:
            t = crossing(c, degree, deep, t, high)
            return t, speed(c, degree, reach, t), True
    return NEVER, 0.0, False


@compiled
def speed(c, degree, reach, t):  # type: ignore[no-untyped-def]
    """Closing speed at t, m/s; `reach` as in `meeting`."""
    if reach == 0.0:
        return -slope(c, degree, t)
    return -0.5 * slope(c, degree, t) / np.sqrt(value(c, degree, t) + reach * reach)
