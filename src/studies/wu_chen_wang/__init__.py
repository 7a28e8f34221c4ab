"""The plane of Wu, Chen & Wang."""
