"""Copies of small arrays in compiled functions.

`target[:] = source` takes several times as long to compile: numba checks shapes and overlaps, and formats errors.
"""

from __future__ import annotations

from models.numerics.jit import compile_kernel


@compile_kernel
def copy_numbers(source, target):  # type: ignore[no-untyped-def]
    """Copy an array (n,) to the first n numbers of another, which it does not overlap."""
    for k in range(len(source)):
        target[k] = source[k]


@compile_kernel
def copy_rows(source, target):  # type: ignore[no-untyped-def]
    """Copy an array (n, m) to the first n rows of another, which it does not overlap."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
