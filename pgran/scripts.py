"""The commands of an installation; each runs a module as `python -m` does."""

import runpy
from functools import partial


def start(module):
    """Run ``python -m module`` in this process."""
    runpy.run_module(module, run_name="__main__", alter_sys=True)


run = partial(start, "pgran")
eigen, stability, growth, measure, plot, watch, pack, figures = (
    partial(start, f"pgran.{name}") for name in (
        "eigen", "stability", "growth", "measure", "plot", "watch", "pack", "figures"))
