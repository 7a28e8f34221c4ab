"""The three structures of cofactors: what one knows of a row, the others know too."""

import numpy as np
import pytest

from analysis.adjustment.problem import CommonCofactors, DenseCofactors, EIVProblem, RowCofactors

N, M = 7, 3
GENERATOR = np.random.default_rng(1)
Z = np.append(-GENERATOR.standard_normal(M), 1.0)
COLUMNS = GENERATOR.standard_normal((M, N))
MULTIPLIERS, T = GENERATOR.standard_normal((2, N))


def slope_of(cofactors):
    return cofactors.slope(Z, MULTIPLIERS, cofactors.errors(Z, MULTIPLIERS))


def symmetric(*lead, size=M + 1):
    root = GENERATOR.standard_normal((*lead, size, size + 2))
    return root @ root.swapaxes(-1, -2)


def common():
    C = np.zeros((M + 1, M + 1))
    C[:M, :M] = symmetric(size=M)
    return CommonCofactors(C, GENERATOR.uniform(1, 2, N), GENERATOR.uniform(1, 2, N))


def rows_of(cofactors):
    """Cofactors as one matrix per row."""
    if isinstance(cofactors, RowCofactors):
        return cofactors
    Q = cofactors.g[:, None, None] * cofactors.C
    Q[:, -1, -1] += cofactors.h
    return RowCofactors(Q)


def dense_of(cofactors):
    """Cofactors as blocks (n, n) of columns."""
    return DenseCofactors(np.einsum("njk,np->jknp", rows_of(cofactors).Q, np.eye(N)))


STRUCTURES = {"common": common(), "rows": RowCofactors(symmetric(N))}
every_structure = pytest.mark.parametrize("structure", STRUCTURES.values(), ids=STRUCTURES.keys())


def assert_agree(one, other):
    s, S = one.misclosure(Z), other.misclosure(Z)
    np.testing.assert_allclose(np.diag(s), S, atol=1e-12)
    np.testing.assert_allclose(one.weigh(s, COLUMNS), other.weigh(S, COLUMNS), atol=1e-12)
    np.testing.assert_allclose(one.errors(Z, MULTIPLIERS), other.errors(Z, MULTIPLIERS), atol=1e-12)
    np.testing.assert_allclose(slope_of(one), slope_of(other), atol=1e-12)


@every_structure
def test_structures_agree(structure):
    assert_agree(structure, dense_of(structure))
    whole, part = (
        dense_of(structure).weighted_sum(MULTIPLIERS, T),
        structure.weighted_sum(MULTIPLIERS, T),
    )
    # what belongs to y alone is left out: no solver needs it
    if isinstance(structure, CommonCofactors):
        whole[-1, -1] = part[-1, -1]
    np.testing.assert_allclose(part, whole, atol=1e-12)


@every_structure
def test_misclosure_is_the_propagated_variance(structure):
    Q = rows_of(structure).Q
    np.testing.assert_allclose(
        structure.misclosure(Z), [Z @ Q[i] @ Z for i in range(N)], rtol=1e-13
    )


@every_structure
def test_errors_and_slope_are_what_they_say(structure):
    """ẽ = Q Bᵀλ, and the slope of Σλs over x, by complex steps."""
    Q = rows_of(structure).Q
    errors = np.stack([MULTIPLIERS[i] * (Q[i] @ Z)[:M] for i in range(N)], axis=1)
    np.testing.assert_allclose(structure.errors(Z, MULTIPLIERS), errors, rtol=1e-12)
    for j in range(M):
        moved = Z.astype(complex)
        moved[j] -= 1e-30j  # z = (−x, 1)
        slope = structure.misclosure(moved).imag / 1e-30
        np.testing.assert_allclose(slope_of(structure)[j], -slope * MULTIPLIERS, rtol=1e-12)


def test_slope_of_correlated_rows():
    """There ∂S/∂x_j has two unequal halves: Q_jk and its transpose."""
    Q = symmetric(size=N * (M + 1)).reshape(M + 1, N, M + 1, N).swapaxes(1, 2)
    cofactors = DenseCofactors(Q)
    for j in range(M):
        moved = Z.astype(complex)
        moved[j] -= 1e-30j
        slope = cofactors.misclosure(moved).imag / 1e-30
        np.testing.assert_allclose(slope_of(cofactors)[j], -slope @ MULTIPLIERS, rtol=1e-11)
    assert np.abs(slope_of(cofactors) - 2 * cofactors.errors(Z, MULTIPLIERS)).max() > 0.1


def test_dense_blocks():
    """vec(A) goes column by column."""
    whole = symmetric(size=N * (M + 1))
    cofactors = DenseCofactors.from_blocks(
        whole[M * N :, M * N :], whole[: M * N, : M * N], whole[: M * N, M * N :]
    )
    np.testing.assert_array_equal(
        cofactors.Q.swapaxes(1, 2).reshape(N * (M + 1), N * (M + 1)), whole
    )
    B = np.kron(Z, np.eye(N))
    np.testing.assert_allclose(cofactors.misclosure(Z), B @ whole @ B.T, rtol=1e-12)


@every_structure
def test_transformed_rows_have_transformed_cofactors(structure):
    L = GENERATOR.standard_normal((M + 1, M + 1))
    L[:-1, -1] = 0.0  # y's own part stays y's own
    transformed = structure.transformed(L)
    np.testing.assert_allclose(
        rows_of(transformed).Q, L @ rows_of(structure).Q @ L.T, rtol=1e-12, atol=1e-12
    )
    assert_agree(transformed, dense_of(structure).transformed(L))


def test_selected_problems_of_a_stack():
    C, g, h = symmetric(6), GENERATOR.uniform(1, 2, (6, N)), GENERATOR.uniform(1, 2, (6, 1))
    stack = EIVProblem(GENERATOR.standard_normal((6, M + 1, N)), CommonCofactors(C, g, h))
    assert (stack.count, stack.parameters) == (N, M)
    keep = np.array([True, False, False, True, False, True])
    np.testing.assert_array_equal(stack[keep].rows, stack.rows[keep])
    z = np.tile(Z, (6, 1))
    np.testing.assert_array_equal(
        stack[keep].cofactors.misclosure(z[keep]), stack.cofactors.misclosure(z)[keep]
    )


def test_stack_of_correlated_problems_is_each_of_them():
    Q = symmetric(3, size=N * (M + 1)).reshape(3, M + 1, N, M + 1, N).swapaxes(-2, -3)
    z, columns, multipliers = (
        GENERATOR.standard_normal((3, M + 1)),
        GENERATOR.standard_normal((3, M, N)),
        GENERATOR.standard_normal((3, N)),
    )
    stack = DenseCofactors(Q)
    S, errors = stack.misclosure(z), stack.errors(z, multipliers)
    for i in range(3):
        one = DenseCofactors(Q[i])
        np.testing.assert_allclose(S[i], one.misclosure(z[i]), rtol=1e-12)
        np.testing.assert_allclose(
            stack.weigh(S, columns)[i], one.weigh(S[i], columns[i]), rtol=1e-9
        )
        np.testing.assert_allclose(
            errors[i], one.errors(z[i], multipliers[i]), rtol=1e-11, atol=1e-11
        )
        slope = one.slope(z[i], multipliers[i], errors[i])
        np.testing.assert_allclose(
            stack.slope(z, multipliers, errors)[i], slope, rtol=1e-11, atol=1e-11
        )
        V = one.weighted_sum(multipliers[i], multipliers[i])
        np.testing.assert_allclose(stack.weighted_sum(multipliers, multipliers)[i], V, rtol=1e-11)
        L = GENERATOR.standard_normal((M + 1, M + 1))
        np.testing.assert_allclose(
            stack.transformed(L).Q[i], one.transformed(L).Q, rtol=1e-11, atol=1e-11
        )
