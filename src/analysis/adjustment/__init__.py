"""Linear adjustment with errors in all variables, without geometry."""
