"""Weight functions of M-estimation.

An M-estimator minimises Σ ρ(uᵢ) over the standardised residuals u = V/σ, or solves Σ ψ(uᵢ) ∂uᵢ/∂x =
0 with ψ = ρ′, or repeats a least-squares fit with the weight factors ω(u) = ψ(u)/u: three faces of
one function. Each class here is one such function, written down for t = |u|; its constants at the
normal law follow. A new weight function is one such class and one line in `WEIGHT_FUNCTIONS`.
Everything is dimensionless.

References
----------
Beaton & Tukey (1974), Technometrics 16, 147-185.
Hampel, Ronchetti, Rousseeuw & Stahel (1986), Robust Statistics: The Approach Based on Influence
Functions, Wiley. Huber (1964), Annals of Mathematical Statistics 35, 73-101.
Krarup, Juhl & Kubik (1980), Götterdämmerung over least squares adjustment, 14th ISP Congress,
Hamburg. Ou & Liu (2017), doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
Yang, Song & Xu (2002), Journal of Geodesy 76, 353-358.
Zhou (1989), Acta Geodaetica et Cartographica Sinica 18, 115-120.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.integrate import quad

__all__ = [
    "WEIGHT_FUNCTIONS",
    "IGG1",
    "IGG3",
    "Bisquare",
    "Danish",
    "Hampel",
    "Huber",
    "WeightFunction",
]

# thresholds (k0, k1) of IGG III: as Ou & Liu print them, and those of the robust fits, which are
# 98 % efficient at the normal law
PRINTED_THRESHOLDS = (1.5, 2.5)
EFFICIENT_THRESHOLDS = (2.5, 4.0)
# 1/Φ⁻¹(3/4), which makes the median absolute deviation a standard deviation at the normal law; and
# rounded as it is usually printed
MAD_TO_SD = 1.482602218505602
ROUNDED_MAD_TO_SD = 1.4826


def _magnitude(u):
    """|u| as a new float64 array, made in one pass whatever the shape and type of u."""
    return np.abs(u, out=np.empty(np.shape(u)))


@dataclass(frozen=True)
class WeightFunction(ABC):
    """An even loss ρ, its derivative ψ, its weight ω and its constants at the normal law.

    The functions take u of any shape; 0 and ±∞ are allowed, and NaN stays NaN.

    >>> huber = WEIGHT_FUNCTIONS["huber"]
    >>> huber.psi([-9.0, 0.5, math.inf])
    array([-1.345,  0.5  ,  1.345])
    >>> print(f"{huber.mean_psi_prime:.4f}")
    0.8214
    """

    @property
    def kinks(self) -> tuple[float, ...]:
        """The thresholds, which are the float fields, ascending; between them ψ is smooth."""
        return tuple(getattr(self, field.name) for field in fields(self) if field.type == "float")

    def rho(self, u):
        """The loss ρ(u); it is 0 at 0 and behaves like u²/2 there."""
        return self._rho(_magnitude(u))[()]

    def psi(self, u):
        """The influence ψ(u) = ρ′(u) = u ω(u), an odd function."""
        u = np.clip(np.asarray(u, dtype=float), -1e300, 1e300)  # because ∞·0 is not a number
        return u * self.weight(u)

    def weight(self, u):
        """The factor ω(u) = ψ(u)/u; it falls from 1 at u = 0 and is never negative."""
        return self._weight(_magnitude(u))[()]

    def weight_slope(self, u):
        """u ω′(u), which Newton's method needs; 0 where the weight does not depend on u."""
        return self._weight_slope(_magnitude(u))[()]

    @property
    def mean_weight(self) -> float:
        """E[ω] for normal u."""
        return _normal_means(self)[0]

    @property
    def mean_psi_prime(self) -> float:
        """E[ψ′] for normal u as E[uψ] = E[ωu²] (Stein's lemma), so that a jump of ψ counts."""
        return _normal_means(self)[1]

    @property
    def mean_psi_squared(self) -> float:
        """E[ψ²] for normal u."""
        return _normal_means(self)[2]

    @property
    def efficiency(self) -> float:
        """(E[ψ′])²/E[ψ²]: for normal errors, variance of least squares over that with ω."""
        return self.mean_psi_prime**2 / self.mean_psi_squared

    @property
    def consistency_factor(self) -> float:
        """κ = E[ωu²]/E[ω]: for normal errors Σ ωV²/(κ Σ ω) tends to σ²; Σ ωV²/Σ ω is too small."""
        return self.mean_psi_prime / self.mean_weight

    @property
    def covariance_factor(self) -> float:
        """E[ω]E[ψ²]/E[ψ′]²: that of σ²(Σ ω JᵀJ)⁻¹, the covariance of the M-estimator.

        Σ ω JᵀJ estimates E[ω] times the normal matrix of the good points.
        Source: Huber 1981, section 7.6.
        """
        return self.mean_weight * self.mean_psi_squared / self.mean_psi_prime**2

    def _require(self, satisfied, rule):
        if not satisfied:
            raise ValueError(f"expected {rule}, got {self}")

    # What a class states, for an array t = |u| that it may overwrite:

    @abstractmethod
    def _rho(self, t): ...

    @abstractmethod
    def _weight(self, t): ...

    @abstractmethod
    def _weight_slope(self, t): ...


@cache  # equal functions share them: the quadrature takes longer than a small adjustment
def _normal_means(function: WeightFunction) -> tuple[float, float, float]:
    """E[ω], E[ωu²] and E[ψ²] for normal u, by adaptive quadrature from kink to kink.

    It goes up to 40, where the density is 0.
    """
    edges = [0.0, *(kink for kink in function.kinks if kink < 40.0), 40.0]

    def mean(f) -> float:
        def integrand(u):
            return f(u) * math.exp(-u * u / 2)

        pieces = [
            quad(integrand, *piece, epsabs=1e-13, epsrel=1e-12, limit=200)[0]
            for piece in pairwise(edges)
        ]
        return float(math.sqrt(2 / math.pi) * sum(pieces))

    return (
        mean(function.weight),
        mean(lambda u: u * function.psi(u)),
        mean(lambda u: function.psi(u) ** 2),
    )


@dataclass(frozen=True)
class IGG3(WeightFunction):
    """IGG III: ω = 1 if t < k0, (k0/t)·((k1 − t)/(k1 − k0))^power if k0 ≤ t < k1, 0 if t ≥ k1.

    Ou & Liu (2017), eq. (13), prints the power 1: Hampel's function with a = b = k0 and c = k1.
    The standard form has the power 2: Yang, Song & Xu (2002).
    Raises ValueError unless 0 < k0 < k1 < ∞ and power is 1 or 2.

    >>> IGG3().weight([1.0, -2.0, 2.5])
    array([1.   , 0.375, 0.   ])
    >>> print(f"{IGG3().efficiency:.3f} {IGG3(power=2).efficiency:.3f}")
    0.766 0.696
    """

    k0: float = PRINTED_THRESHOLDS[0]
    k1: float = PRINTED_THRESHOLDS[1]
    power: int = 1

    def __post_init__(self):
        self._require(
            0 < self.k0 < self.k1 < math.inf and self.power in (1, 2),
            "0 < k0 < k1 < ∞ and power 1 or 2",
        )

    def _rho(self, t):
        width = self.k1 - self.k0
        left = (self.k1 - np.clip(t, self.k0, self.k1)) / width
        n = self.power + 1
        return np.minimum(t, self.k0) ** 2 / 2 + self.k0 * width / n * (1 - left**n)

    def _weight(self, t):
        # The inner loop of every robust fit: one branch serves all t once they are clipped to it.
        # It is exactly 1 at k0, where numerator and denominator are the same number, and exactly 0
        # at k1.
        w = self._middle(np.clip(t, self.k0, self.k1, out=t))
        w /= self._middle(self.k0)
        return w

    def _middle(self, t):
        """(k1 − t)^power/t, the middle branch of ω but for a constant factor."""
        w = self.k1 - t
        if self.power == 2:
            w *= w
        w /= t
        return w

    def _weight_slope(self, t):
        width, falls = self.k1 - self.k0, (t >= self.k0) & (t < self.k1)
        left = (self.k1 - t[falls]) / width
        slope = np.zeros_like(t)
        slope[falls] = -self.k0 * left ** (self.power - 1) * (left / t[falls] + self.power / width)
        return slope


@dataclass(frozen=True)
class IGG1(WeightFunction):
    """IGG I, Huber's function cut off: ω = 1 if t < k0, k0/t if k0 ≤ t < k1, 0 if t ≥ k1.

    Zhou (1989). ψ jumps from k0 to 0 at k1. Raises ValueError unless 0 < k0 < k1 < ∞.

    >>> IGG1().weight([1.0, -2.0, 2.5])
    array([1.  , 0.75, 0.  ])
    """

    k0: float = PRINTED_THRESHOLDS[0]
    k1: float = PRINTED_THRESHOLDS[1]

    def __post_init__(self):
        self._require(0 < self.k0 < self.k1 < math.inf, "0 < k0 < k1 < ∞")

    def _rho(self, t):
        return np.minimum(t, self.k0) ** 2 / 2 + self.k0 * (np.clip(t, self.k0, self.k1) - self.k0)

    def _weight(self, t):
        return np.where(t >= self.k1, 0.0, self.k0 / np.maximum(t, self.k0))

    def _weight_slope(self, t):
        return np.where((t >= self.k0) & (t < self.k1), -self.k0 / np.maximum(t, self.k0), 0.0)


@dataclass(frozen=True)
class Huber(WeightFunction):
    """Huber: ω = 1 if t < c, c/t if t ≥ c. ψ never falls, and no residual is rejected.

    Huber (1964). The default c has 95 % efficiency. Raises ValueError unless 0 < c < ∞.

    >>> Huber().weight([1.0, -2.69])
    array([1. , 0.5])
    """

    c: float = 1.345

    def __post_init__(self):
        self._require(0 < self.c < math.inf, "0 < c < ∞")

    def _rho(self, t):
        return np.minimum(t, self.c) ** 2 / 2 + self.c * (np.maximum(t, self.c) - self.c)

    def _weight(self, t):
        return self.c / np.maximum(t, self.c)

    def _weight_slope(self, t):
        return np.where(t >= self.c, -self.c / np.maximum(t, self.c), 0.0)


@dataclass(frozen=True)
class Hampel(WeightFunction):
    """Hampel: ψ = t if t < a, a if t < b, a·(c − t)/(c − b) if t < c, 0 if t ≥ c.

    Hampel et al. (1986). Raises ValueError unless 0 < a ≤ b < c < ∞.

    >>> Hampel().weight([1.0, -4.0, 6.4, 8.0])
    array([1.   , 0.5  , 0.125, 0.   ])
    """

    a: float = 2.0
    b: float = 4.0
    c: float = 8.0

    def __post_init__(self):
        self._require(0 < self.a <= self.b < self.c < math.inf, "0 < a ≤ b < c < ∞")

    def _left(self, t):
        return (self.c - np.clip(t, self.b, self.c)) / (self.c - self.b)

    def _rho(self, t):
        level = self.a * (np.clip(t, self.a, self.b) - self.a)
        falling = self.a * (self.c - self.b) / 2 * (1 - self._left(t) ** 2)
        return np.minimum(t, self.a) ** 2 / 2 + level + falling

    def _weight(self, t):
        return self.a / np.maximum(t, self.a) * self._left(t)

    def _weight_slope(self, t):
        over = self.a / np.maximum(t, self.a)
        falling = np.where(t < self.c, -over * self.c / (self.c - self.b), 0.0)
        return np.where(t >= self.b, falling, np.where(t >= self.a, -over, 0.0))


@dataclass(frozen=True)
class Bisquare(WeightFunction):
    """Tukey's bisquare: ω = (1 − (t/c)²)² if t < c, 0 if t ≥ c.

    Beaton & Tukey (1974). The default c has 95 % efficiency. Raises ValueError unless 0 < c < ∞.

    >>> Bisquare(c=4.0).weight([0.0, -2.0, 4.0])
    array([1.    , 0.5625, 0.    ])
    """

    c: float = 4.685

    def __post_init__(self):
        self._require(0 < self.c < math.inf, "0 < c < ∞")

    def _squared(self, t):
        return (np.minimum(t, self.c) / self.c) ** 2

    def _rho(self, t):
        z2 = self._squared(t)
        # c²/6·(1 − (1 − z²)³) without cancellation near 0
        return self.c**2 / 6 * z2 * (3 - 3 * z2 + z2**2)

    def _weight(self, t):
        return (1 - self._squared(t)) ** 2

    def _weight_slope(self, t):
        z2 = self._squared(t)
        return -4 * z2 * (1 - z2)


@dataclass(frozen=True)
class Danish(WeightFunction):
    """The Danish method, continuous: ω = 1 if t < c, exp(1 − (t/c)²) if t ≥ c.

    After Krarup, Juhl & Kubik (1980); its exponential weights are in use with several exponents and
    limits. The default c has 95 % efficiency. Raises ValueError unless 0 < c < ∞.

    >>> Danish().weight([-1.0, 2.0, 4.0]).round(4)
    array([1.    , 1.    , 0.0498])
    """

    c: float = 2.0

    def __post_init__(self):
        self._require(0 < self.c < math.inf, "0 < c < ∞")

    def _exponent(self, t):
        return 1 - np.clip(t / self.c, 1, 30) ** 2  # beyond 30 the exponential is 0

    def _rho(self, t):
        return np.minimum(t, self.c) ** 2 / 2 - self.c**2 / 2 * np.expm1(self._exponent(t))

    def _weight(self, t):
        return np.exp(self._exponent(t))

    def _weight_slope(self, t):
        exponent = self._exponent(t)
        return np.where(t >= self.c, 2 * (exponent - 1) * np.exp(exponent), 0.0)


WEIGHT_FUNCTIONS: dict[str, WeightFunction] = {
    "igg3": IGG3(),
    "igg3_squared": IGG3(power=2),
    "igg1": IGG1(),
    "huber": Huber(),
    "hampel": Hampel(),
    "bisquare": Bisquare(),
    "danish": Danish(),
}
