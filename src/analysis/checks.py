"""Checks of input, with errors that name what was expected and what came.

Functions that return arrays are named by them; those of single values begin with ``check_``.
"""

from __future__ import annotations

import numpy as np

from .blocks import pieces


def real_array(values, name: str) -> np.ndarray:
    """``values`` as float64, without a copy where it is float64 already.

    Raises ``ValueError`` for what is not a real number: text, complex numbers, ragged lists.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "iuf":
            return array.astype(np.float64, copy=False)
        if array.dtype.kind == "O":
            return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name}: expected an array of real numbers, got {type(values).__name__} ({error})"
        ) from None
    raise ValueError(f"{name}: expected an array of real numbers, got dtype {array.dtype}")


def finite_array(values, name: str) -> np.ndarray:
    """A :func:`real_array` without NaN or infinity."""
    array = real_array(values, name)
    flat = array.reshape(-1)
    bad = sum(np.count_nonzero(~np.isfinite(flat[piece])) for piece in pieces(flat.size))
    if bad:
        raise ValueError(
            f"{name}: expected finite numbers, got {bad} NaN or infinite of {array.size}"
        )
    return array


def point_array(points, dimension: int, minimum: int, needed_for: str) -> np.ndarray:
    """Points of shape ``(…, n, dimension)``, float64, finite, with ``n >= minimum``."""
    array = real_array(points, "points")
    if array.ndim < 2 or array.shape[-1] != dimension:
        raise ValueError(f"points: expected shape (…, n, {dimension}), got {array.shape}")
    if array.shape[-2] < minimum:
        raise ValueError(
            f"points: expected at least {minimum} points for {needed_for}, "
            f"got {array.shape[-2]} (shape {array.shape})"
        )
    if array.size == 0:
        raise ValueError(
            f"points: expected at least one cloud, got an empty stack of shape {array.shape}"
        )
    return finite_array(array, "points")


def weight_array(weights, shape: tuple[int, ...], name: str = "weights") -> np.ndarray:
    """Positive ``weights`` that broadcast to ``shape`` = ``(…, n)``."""
    array = finite_array(weights, name)
    if array.ndim == 0 or array.shape[-1] != shape[-1]:
        raise ValueError(f"{name}: expected shape {shape} or ({shape[-1]},), got {array.shape}")
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(
            f"{name}: expected shape {shape} or ({shape[-1]},), got {array.shape}"
        ) from None
    if not (array > 0).all():
        raise ValueError(
            f"{name}: expected positive numbers, got a smallest value of {array.min():g}"
        )
    return array


def covariance_array(values, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Symmetric positive definite matrices that broadcast to ``shape`` = (…, n, d, d)."""
    array = finite_array(values, name)
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(
            f"{name}: expected shape {shape} or {shape[-3:]}, got {array.shape}"
        ) from None
    d = shape[-1]
    if not all(
        np.allclose(array[..., i, j], array[..., j, i], rtol=1e-9, atol=0.0)
        for i in range(d)
        for j in range(i)
    ):
        raise ValueError(f"{name}: expected symmetric matrices, got some that are not")
    try:
        np.linalg.cholesky(array)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(array)[..., 0].min()
        raise ValueError(
            f"{name}: expected positive definite matrices, "
            f"got a smallest eigenvalue of {smallest:.3g}"
        ) from None
    return array


def check_positive(value, name: str) -> float:
    """``value`` as a positive finite float.

    >>> check_positive(0, "k0")
    Traceback (most recent call last):
        ...
    ValueError: k0: expected a positive finite number, got 0
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not 0 < number < float("inf"):
        raise ValueError(f"{name}: expected a positive finite number, got {value!r}")
    return number


def check_whole_number(value, name: str) -> int:
    """``value`` as a positive whole number.

    >>> check_whole_number(2.5, "max_iterations")
    Traceback (most recent call last):
        ...
    ValueError: max_iterations: expected a positive whole number, got 2.5
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise ValueError(f"{name}: expected a positive whole number, got {value!r}")
    return int(value)


def check_one_of(value, known, name: str):
    """``value`` if it is among ``known``, else an error that lists them."""
    # a list, so that what cannot be hashed is refused like everything else
    if value not in list(known):
        raise ValueError(f"{name}: expected one of {', '.join(map(str, known))}; got {value!r}")
    return value
