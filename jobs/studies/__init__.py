"""Studies: questions that are put to many runs. ``python -m studies`` starts and lists them.

The process of a study starts no MPI itself. It starts runs on ranks, measures their result files
and writes tables; `pgran.runs.run_on_ranks` says which runs are not repeated.
"""
