"""Starts `studies.one_step`, which says what it does."""

import sys

from studies.one_step import main

if __name__ == "__main__":
    sys.exit(main(sys.argv))
