"""The figures of the notebooks: one file per notebook, with the same stem."""
