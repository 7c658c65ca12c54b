"""Contact times of two surfaces: the first time at which a gap that is a polynomial in time closes.

A polynomial is monotone between the roots of its derivative. The roots of the highest derivative therefore bracket
those of the next lower one, and so on down to the polynomial. No root is missed, however fast a ball is, and none is
found twice.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel, copy_numbers

# Degree of the squared distance of two quintic paths.
MAX_DEGREE = 10
# m/s: surfaces that close more slowly may overlap by `CONTACT_DEPTH` and then rebound without loss or friction. Balls
# that press on each other, or bounce ever lower, thus meet a finite number of times.
GENTLE_SPEED = 1e-3
# m: overlap at which a gentle contact happens.
CONTACT_DEPTH = 1e-6
# m/s: surfaces that overlap more than `CONTACT_DEPTH` and close more slowly do not meet yet.
STILL_SPEED = 1e-9
NEVER = np.inf


@compile_kernel
def polynomial_value(c, degree, t):  # type: ignore[no-untyped-def]
    """Evaluate the polynomial sum of c[k] t^k."""
    total = c[degree]
    for k in range(degree - 1, -1, -1):
        total = total * t + c[k]
    return total


@compile_kernel
def polynomial_slope(c, degree, t):  # type: ignore[no-untyped-def]
    """Evaluate the derivative of `polynomial_value` with respect to t."""
    total = 0.0
    for k in range(degree, 0, -1):
        total = total * t + k * c[k]
    return total


@compile_kernel
def find_crossing(c, degree, level, low, high):  # type: ignore[no-untyped-def]
    """Find where c passes `level` between low and high.

    c must be monotone there, with its ends on different sides of `level`. Newton's method with bisection as fallback.
    """
    sign = 1.0 if polynomial_value(c, degree, high) > level else -1.0
    t = 0.5 * (low + high)
    for _ in range(100):
        miss = polynomial_value(c, degree, t) - level
        if miss == 0.0:
            break
        if sign * miss > 0.0:
            high = t
        else:
            low = t
        steep = polynomial_slope(c, degree, t)
        new = t - miss / steep if steep != 0.0 else low
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-16 * abs(t) or new == t:
            break
        t = new
    return t


@compile_kernel
def find_turning_points(c, degree, length, work):  # type: ignore[no-untyped-def]
    """Write 0, the roots of the derivative of c within (0, length) and length into work[0], and return their number."""
    roots = work[1]
    roots[0], roots[1] = 0.0, length
    count = 2
    d = work[2]
    for order in range(degree - 1, 0, -1):  # the derivative of this order is monotone between `roots`
        for k in range(degree - order + 1):
            factor = 1.0
            for j in range(k + 1, k + order + 1):
                factor *= j
            d[k] = c[k + order] * factor
        new, new_count = work[0], 1
        new[0] = 0.0
        before = polynomial_value(d, degree - order, roots[0])
        for k in range(count - 1):
            after = polynomial_value(d, degree - order, roots[k + 1])
            if before * after < 0.0:
                new[new_count] = find_crossing(d, degree - order, 0.0, roots[k], roots[k + 1])
                new_count += 1
            elif after == 0.0 and k < count - 2:
                new[new_count] = roots[k + 1]
                new_count += 1
            before = after
        new[new_count] = length
        count = new_count + 1
        copy_numbers(new[:count], roots)
    copy_numbers(roots[:count], work[0])
    return count


@compile_kernel
def find_meeting(c, degree, length, reach, begin, through, work):  # type: ignore[no-untyped-def]
    """Find the first contact of two surfaces.

    They meet where the gap closes at `GENTLE_SPEED` or faster. Where it closes more slowly, they meet once the gap is
    -`CONTACT_DEPTH`.

    Args:
        c: Coefficients (MAX_DEGREE + 1,) of powers of time: of the gap in m where `reach` is 0, else of
            distance^2 - reach^2 of two centres in m^2.
        degree: Degree of the polynomial.
        length: End of the search interval, s.
        reach: Distance of two centres in contact, m; 0 if c is the gap itself.
        begin: Begin of the search interval, s.
        through: If true, a gap that is closed already has to open first.
        work: Work space (3, MAX_DEGREE + 2) or larger, overwritten.

    Returns:
        Time of the contact in s, closing speed in m/s, and whether the contact is gentle. The time is `NEVER` if there
        is no contact.
    """
    level = -CONTACT_DEPTH if reach == 0.0 else CONTACT_DEPTH * (CONTACT_DEPTH - 2.0 * reach)
    while degree > 1 and c[degree] == 0.0:
        degree -= 1
    count = find_turning_points(c, degree, length, work)
    for k in range(count - 1):
        low, high = max(work[0, k], begin), work[0, k + 1]
        if high <= low:
            continue
        gap, end = polynomial_value(c, degree, low), polynomial_value(c, degree, high)
        if end >= min(gap, 0.0) or (through and gap <= 0.0):
            continue
        t = find_crossing(c, degree, 0.0, low, high) if gap > 0.0 else low
        closing = closing_speed(c, degree, reach, t)
        if closing >= GENTLE_SPEED:
            return t, closing, False
        deep = level
        if gap <= level:
            if closing > STILL_SPEED:
                return t, closing, True
            deep = gap - (CONTACT_DEPTH if reach == 0.0 else 2.0 * reach * CONTACT_DEPTH)
        if end <= deep:
            t = find_crossing(c, degree, deep, t, high)
            return t, closing_speed(c, degree, reach, t), True
    return NEVER, 0.0, False


@compile_kernel
def closing_speed(c, degree, reach, t):  # type: ignore[no-untyped-def]
    """Evaluate the closing speed at t, m/s; `reach` as in `find_meeting`."""
    if reach == 0.0:
        return -polynomial_slope(c, degree, t)
    return -0.5 * polynomial_slope(c, degree, t) / np.sqrt(polynomial_value(c, degree, t) + reach * reach)
