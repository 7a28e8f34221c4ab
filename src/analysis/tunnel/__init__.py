"""Tunnel sections and their deformation between two epochs, after Li et al. (2015).

References
----------
Li, Lu, Zhu, Lu, Wu & Li (2015), tunnel section extraction and deformation analysis from laser point
clouds; its equations are numbered (1)-(13), but were lost from the text at hand and are
reconstructed here from its words.
"""
