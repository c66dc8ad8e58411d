"""Linear theory of waves and specimens, and one-dimensional profiles; numpy and scipy only."""
