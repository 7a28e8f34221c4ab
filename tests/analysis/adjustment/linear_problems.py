"""Linear errors-in-variables problems, and textbook algebra to compare with."""

import numpy as np
import pytest

from analysis.adjustment.algorithms import ALGORITHMS
from analysis.adjustment.problem import CommonCofactors, EIVProblem
from studies.ou_liu_2017 import clouds

every_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)
SPHERE_Q_0 = np.diag([1.0, 1.0, 1.0, 0.0])


def sphere_rows(n=60, seed=1):
    """A (n, 4) and y (n,) of the sphere as Ou & Liu print them, from rounded points."""
    points = clouds.sphere_cloud(np.random.default_rng(seed), n)
    return np.column_stack([2 * points, np.ones(n)]), np.sum(points**2, axis=1)


def eiv_problem(A, y, cofactors):
    return EIVProblem(np.column_stack([A, y]).T, cofactors)


def kronecker(Q_0, Q_X, Q_y):
    """``Q_A = Q_0 ⊗ diag(Q_X)`` and diagonal ``Q_y``."""
    C = np.zeros((len(Q_0) + 1, len(Q_0) + 1))
    C[:-1, :-1] = Q_0
    return CommonCofactors(C, Q_X, Q_y)


def point_weights(kind, n=60):
    return np.ones(n) if kind == "equal" else np.random.default_rng(2).uniform(0.2, 5.0, n)


def some_problem(n=15, m=3, seed=3):
    """A, y with errors of a tenth, and a generator for more."""
    generator = np.random.default_rng(seed)
    true = generator.standard_normal((n, m))
    A = true + 0.1 * generator.standard_normal((n, m))
    y = true @ np.arange(1.0, m + 1) + 0.1 * generator.standard_normal(n)
    return A, y, generator


def covariances(generator, count, size):
    """``count`` positive definite matrices of ``size``, none diagonal."""
    root = generator.standard_normal((count, size, 2 * size))
    return 0.01 * root @ root.swapaxes(-1, -2) / (2 * size)


def dense_blocks(rows):
    """Q_y, Q_A, Q_Ay of independent rows with cofactors ``rows`` (n, m+1, m+1)."""
    n, m = len(rows), rows.shape[-1] - 1
    full = np.einsum("nij,np->injp", rows, np.eye(n))
    return full[m, :, m], full[:m, :, :m].reshape(n * m, n * m), full[:m, :, m].reshape(n * m, n)


def profile_objective(A, y, Q_y, Q_A, Q_Ay):
    """Φ(x) = (y − Ax)ᵀ M⁻¹ (y − Ax), M by propagation with Kronecker products, as the textbooks
    write it.
    """

    def phi(x):
        B = np.kron(x, np.eye(len(y)))
        M = Q_y + B @ Q_A @ B.T - B @ Q_Ay - (B @ Q_Ay).T
        return (y - A @ x) @ np.linalg.solve(M, y - A @ x)

    return phi


def minimum_by_newton(phi, x):
    """Minimum of a smooth function by Newton's method with nothing but its values (complex steps,
    then differences).
    """
    for _ in range(12):
        gradient, hessian = numerical_derivatives(phi, x)
        x = x - np.linalg.solve(hessian, gradient)
    return x


def numerical_derivatives(phi, x, step=1e-5):
    """Gradient by complex steps, Hessian by central differences of that gradient."""

    def gradient(x):
        return np.array([phi(x + 1e-30j * e).imag * 1e30 for e in np.eye(len(x))])

    hessian = np.array(
        [(gradient(x + step * e) - gradient(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    )
    return gradient(x), hessian


Q_ROWS = covariances(np.random.default_rng(9), 15, 4)
