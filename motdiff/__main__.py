"""``python -m motdiff``: train, prepare, pack, sample, export."""

import sys

from motdiff.commands import run

if __name__ == "__main__":
    sys.exit(run())
