"""What `make` calls: running notebooks, fetching scans, writing the README's tables and the static
site. No science in here.
"""
