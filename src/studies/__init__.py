"""The three papers, their simulations and the comparison of methods."""
