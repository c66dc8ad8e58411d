"""Space: elements, grid, matrices, weak form and multigrid."""
