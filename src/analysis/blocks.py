"""Pieces of long arrays that fit the processor's cache."""

from __future__ import annotations

# Arrays are processed in pieces of about this many points: the handful of temporaries that a
# piece needs then stays in the processor's cache, and the memory in use does not grow with n.
BLOCK = 16_384


def pieces(count: int, size: int = BLOCK) -> list[slice]:
    """Consecutive slices of at most ``size`` that cover ``range(count)``.

    >>> pieces(5, 2)
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def point_pieces(points) -> list[slice]:
    """Pieces of the point axis of (B, n, dim) such that all B clouds together fill a block."""
    return pieces(points.shape[1], max(1, BLOCK // len(points)))
