"""``python -m motdiff``: train, prepare, pack, sample, export."""

import sys
from io import TextIOWrapper

from motdiff.commands import run

if __name__ == "__main__":
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # signs that its encoding lacks
    sys.exit(run())
