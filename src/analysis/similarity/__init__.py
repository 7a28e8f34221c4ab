"""The similarity ``X = t + μ R x`` between two frames, from pairs of points known in both.

adjustment      ``fit_similarity``: errors in both frames, with covariance, and robust where asked
closed_form     ``umeyama``, by SVD: least squares, all errors in the target; the start of the other
robust          a start from the pairs that agree, and weights by a test of each against the others
transformation  ``Similarity``, the result: transforms points and propagates its accuracy to them
pairs           what pairs must be

The parameters of the adjustment are (t, ω, μ), ω a small rotation about the axes of the target
frame, ``R ← exp([ω]×) R``, so their cofactor obeys no constraint. Everything is solved about the
centroids of the two sets.
"""

from .adjustment import fit_similarity
from .closed_form import umeyama
from .transformation import Similarity

__all__ = ["Similarity", "fit_similarity", "umeyama"]
