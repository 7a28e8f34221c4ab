"""How far can each method be trusted? Monte Carlo studies of bias, efficiency, breakdown,
confidence and collapse.

One study a file; each is a function that returns a tidy table. Fits that did not converge are
counted in a column ``failed``. A trial draws from its own child of ``SeedSequence(seed)``, so it
stays the same when the number of trials grows, and it keeps its random numbers from setting to
setting, so that a curve is not blurred by new draws.
"""
