"""Simulated scans: scenes of surfaces, and a tunnel."""
