"""Studies: questions that are put to many runs. ``python -m pgran.studies`` starts and lists them.

The process of a study starts no MPI itself. It starts runs on ranks, measures their result files
and writes tables; `pgran.studies.launch` says which runs are not repeated.
"""
