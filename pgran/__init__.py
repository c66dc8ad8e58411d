"""pgran: parallel dense granular flow with non-local rheology.

From the linear stability of a rheology to its shear bands: the local inertial
rheology mu(I) and the non-local granular fluidity model on structured Q2-Q1
grids, solved with PETSc.
"""

__version__ = "0.2.0"
