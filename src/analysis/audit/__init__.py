"""Which printed numbers can be believed? Checks that need no data, hypotheses with their likelihoods, a verdict on each number.

rows         can the numbers of a row be true together, whatever the gross errors were
relation     a relation between printed numbers, and the tables it is applied to
checks       all relations that right tables fulfil, each with its proof; `CHECKS`
trials       how often the checks are wrong on right tables, and how often they find a planted slip
gross        gross errors of other sizes than those of the committed cloud
hypotheses   what the authors may have done, with likelihoods side by side
search       which five gross errors come nearest to the printed rows of table 2
judgement    a verdict with its reason, and the ways to reach one
sphere_numbers, plane_numbers, tunnel_numbers    how each printed number of a paper is judged
verdicts     one row a printed number, and their counts
"""

from .rows import (
    good_points,
    igg3_readings,
    least_sigma_0,
    normal_equation,
    printed_spheres,
    radius_errors_with_wrong_sign,
    radius_with_wrong_sign,
)

__all__ = [
    "good_points",
    "igg3_readings",
    "least_sigma_0",
    "normal_equation",
    "printed_spheres",
    "radius_errors_with_wrong_sign",
    "radius_with_wrong_sign",
]
