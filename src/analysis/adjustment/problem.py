"""The errors-in-variables problem: rows, and what is known of their errors.

    y − e_y = (A − E_A) x                                    (Ou & Liu 2017, eq. 1)

Row i of the problem is ``ℓ_i = (a_i, y_i)``, m + 1 numbers with a joint cofactor. With
``z = (−x, 1)`` its misclosure is ``r_i = ℓ_i·z = y_i − a_i x`` and the cofactor of that
misclosure follows by propagation. Three structures of cofactors are known here:

========================  =============================================  =================
class                     cofactor of the rows                           misclosure
========================  =============================================  =================
:class:`CommonCofactors`  ``g_i C + h_i e eᵀ`` (e picks y)               O(1) per row
:class:`RowCofactors`     any ``(m+1, m+1)`` matrix per row, rows free   O(m²) per row
:class:`DenseCofactors`   any ``(n(m+1), n(m+1))`` matrix                O(n³): reference
========================  =============================================  =================

The Kronecker structure ``Q_A = Q_0 ⊗ Q_X`` with diagonal Q_X and Q_y is the first of them.
Rows are stored one array per coordinate, ``(…, m+1, n)``: what is done to all points at once
then runs through contiguous memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from .iteration import Stack
from .linalg import solve


class Cofactors(Stack, ABC):
    """A structure of the cofactors of the rows, as the solvers use it.

    ``z = (−x, 1)`` (…, m+1) stands for the parameters, λ for the multipliers ``S⁻¹r`` (…, n).
    """

    @abstractmethod
    def misclosure(self, z: np.ndarray) -> np.ndarray:
        """Cofactor of the misclosures: its diagonal s (…, n), or the matrix S (…, n, n)."""

    @abstractmethod
    def weigh(self, s: np.ndarray, columns: np.ndarray, weights=1.0) -> np.ndarray:
        """``ω S⁻¹`` times each of the ``columns`` (…, k, n); ``weights`` ω (…, n) or 1."""

    @abstractmethod
    def errors(self, z: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Predicted errors of A, ``ẽ = Q Bᵀ λ`` without its y part, (…, m, n)."""

    @abstractmethod
    def slope(self, z: np.ndarray, multipliers: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """``−(∂S/∂x_j) λ``, (…, m, n), from the predicted errors."""

    @abstractmethod
    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
        """``Σ λ_i t_i Q_i``, (…, m+1, m+1); what only y has may be left out of its last element."""


class IndependentRows(Cofactors):
    """Base of the structures with independent rows: one misclosure cofactor s (…, n) per row."""

    @abstractmethod
    def column_cofactors(self, z: np.ndarray) -> np.ndarray:
        """``Q_i z`` without its y component, (…, m, n)."""

    def weigh(self, s: np.ndarray, columns: np.ndarray, weights=1.0) -> np.ndarray:
        return columns * (weights / s)[..., None, :]

    def errors(self, z: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        return self.column_cofactors(z) * multipliers[..., None, :]

    def slope(self, z: np.ndarray, multipliers: np.ndarray, errors: np.ndarray) -> np.ndarray:
        return 2.0 * errors  # because each Q_i is symmetric


@dataclass(frozen=True)
class CommonCofactors(IndependentRows):
    """Cofactor of row i: ``g_i C + h_i e eᵀ``, with e the unit vector that picks y.

    C : (…, m+1, m+1) symmetric, the part common to all rows; exact columns are zero in it.
    g : (…, n) or (…, 1), its factor per row (``Q_X`` of the Kronecker form).
    h : (…, n) or (…, 1), what y has beyond it.
    """

    C: np.ndarray
    g: np.ndarray
    h: np.ndarray

    def misclosure(self, z: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...ij,...j->...", z, self.C, z)[..., None] * self.g + self.h

    def column_cofactors(self, z: np.ndarray) -> np.ndarray:
        return np.einsum("...ij,...j->...i", self.C, z)[..., :-1, None] * self.g[..., None, :]

    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
        g = np.broadcast_to(self.g, t.shape)
        return np.einsum("...n,...n,...n->...", multipliers, t, g)[..., None, None] * self.C

    def transformed(self, L: np.ndarray) -> CommonCofactors:
        """Cofactors of the rows ``L ℓ_i``; the last column of L must be a multiple of e."""
        return CommonCofactors(L @ self.C @ L.mT, self.g, self.h * L[..., -1, -1, None] ** 2)


@dataclass(frozen=True)
class RowCofactors(IndependentRows):
    """Any cofactor ``Q`` (…, n, m+1, m+1) for each row ``(a_i, y_i)``; rows are independent."""

    Q: np.ndarray

    def misclosure(self, z: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...nij,...j->...n", z, self.Q, z, optimize=True)

    def column_cofactors(self, z: np.ndarray) -> np.ndarray:
        return np.einsum("...nij,...j->...in", self.Q, z)[..., :-1, :]

    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.einsum("...n,...nij->...ij", multipliers * t, self.Q)

    def transformed(self, L: np.ndarray) -> RowCofactors:
        """Cofactors of the rows ``L ℓ_i``."""
        L = L[..., None, :, :]
        return RowCofactors(L @ self.Q @ L.mT)


@dataclass(frozen=True)
class DenseCofactors(Cofactors):
    """Any joint cofactor of all rows, as blocks ``Q[…, j, k]`` (n, n) = cov(column j, column k).

    Column m is y. The only place where an n×n matrix is formed: for problems correlated from row to
    row, and to check the others.
    """

    Q: np.ndarray

    @classmethod
    def from_blocks(cls, Q_y: np.ndarray, Q_A: np.ndarray, Q_Ay: np.ndarray) -> DenseCofactors:
        """From ``Q_y`` (n, n), ``Q_A`` (nm, nm) of vec(A) column by column and ``Q_Ay`` (nm, n)."""
        n = len(Q_y)
        joint = np.block([[Q_A, Q_Ay], [Q_Ay.T, Q_y]])
        return cls(joint.reshape(-1, n, len(joint) // n, n).swapaxes(1, 2))

    def misclosure(self, z: np.ndarray) -> np.ndarray:
        return np.einsum("...j,...jkab,...k->...ab", z, self.Q, z, optimize=True)

    def weigh(self, s: np.ndarray, columns: np.ndarray, weights=1.0) -> np.ndarray:
        return solve(s, columns.mT).mT  # correlated rows take no weights ω but 1

    def errors(self, z: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        joint = np.einsum("...jkab,...k,...b->...ja", self.Q, z, multipliers, optimize=True)
        return joint[..., :-1, :]

    def slope(self, z: np.ndarray, multipliers: np.ndarray, errors: np.ndarray) -> np.ndarray:
        # the predicted errors and their transposed counterpart
        transposed = np.einsum("...kjab,...k,...b->...ja", self.Q, z, multipliers, optimize=True)
        return errors + transposed[..., :-1, :]

    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.einsum("...a,...jkab,...b->...jk", multipliers, self.Q, t, optimize=True)

    def transformed(self, L: np.ndarray) -> DenseCofactors:
        """Cofactors of the rows ``L ℓ_i``."""
        Q = np.einsum("...ij,...jkab,...lk->...ilab", L, self.Q, L, optimize=True)
        return DenseCofactors(Q)


@dataclass(frozen=True)
class EIVProblem(Stack):
    """Rows ``(…, m+1, n)`` of ``[A | y]``, one array per column, with cofactors of their errors."""

    rows: np.ndarray
    cofactors: Cofactors

    @property
    def count(self) -> int:
        return self.rows.shape[-1]

    @property
    def parameters(self) -> int:
        return self.rows.shape[-2] - 1
