"""Runs from Python: in this process, on ranks, and sweeps."""
