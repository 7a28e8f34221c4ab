"""Orthogonal distances to any surface: adjustment, robust fit, reliability."""
