"""The similarity ``X = t + μ R x`` between two frames, from pairs of points known in both.

closed_form     ``umeyama``, by SVD: least squares, all errors in the target; the start of the other
adjustment      ``fit_similarity``: errors in both frames, with covariance, and robust where asked
robust          a start from the pairs that agree, and weights by a test of each against the others
transformation  ``Similarity``, the result: transforms points and propagates its accuracy to them
pairs           what pairs must be

A pair has the misclosure ``r = X − t − μ R x``; with cofactors Q_x and Q_X of its two points r has
the cofactor ``S = Q_X + μ² R Q_x Rᵀ``, and the adjustment is ``min Σ rᵀ S⁻¹ r``. Its parameters are
(t, ω, μ), ω a small rotation about the axes of the target frame, ``R ← exp([ω]×) R``, so their
cofactor obeys no constraint. Everything is solved about the centroids of the two sets.

References
----------
Kabsch (1976), Acta Crystallographica A 32, 922-923.
Neitzel (2010), Journal of Geodesy 84, 751-762 (errors in both frames by Gauss-Helmert).
Umeyama (1991), IEEE Transactions on Pattern Analysis and Machine Intelligence 13, 376-380.
"""

from .adjustment import fit_similarity
from .closed_form import umeyama
from .transformation import Similarity

__all__ = ["Similarity", "fit_similarity", "umeyama"]
