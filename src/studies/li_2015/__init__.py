"""The tunnel sections of Li et al. 2015."""
