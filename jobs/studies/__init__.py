"""Studies: measurements over many runs. ``python -m studies`` lists and starts them."""
