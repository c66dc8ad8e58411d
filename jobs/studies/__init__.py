"""Studies: lists of runs, a measurement of each, and tables and figures of the documentation.

The process of a study starts no MPI. `pgran.runs.run_on_ranks` starts its runs and reuses complete
ones.
"""
