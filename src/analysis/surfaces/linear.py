"""A surface as a linear errors-in-variables problem: what sphere and plane have in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.cofactors import gauss_newton_cofactor
from ..adjustment.iteration import Convergence, Stack
from ..adjustment.linalg import unit_weight_sd
from ..adjustment.problem import EIVProblem
from ..adjustment.steps import objective
from ..result import Adjustment, Array


@dataclass(frozen=True)
class PrintedSurface(Stack):
    """The printed problem of a stack in the clouds' own frames; a base for ``igg3.Printed``.

    jacobian : (B, t, t) ∂X/∂x of the printed parameters X by those in the frame
    """

    problem: EIVProblem
    origin: Array
    length: Array
    jacobian: Array

    def step(self, difference: Array) -> Array:
        """|ΔX| (B,) from a difference of x (B, t)."""
        return np.linalg.norm((self.jacobian @ difference[..., None])[..., 0], axis=-1)


def solution(
    problem: EIVProblem, x: Array, convergence: Convergence, redundancy: int
) -> Adjustment:
    """The adjustment that x solves, with σ0 = √(Φ/(n − t)) and the cofactor of Gauss-Newton."""
    sigma = unit_weight_sd(objective(problem, x), redundancy)
    return Adjustment(x, gauss_newton_cofactor(problem, x), sigma, None, convergence)
