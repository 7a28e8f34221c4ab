"""Tunnel sections and their deformation between two epochs, after Li et al. (2015)."""
