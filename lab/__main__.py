"""``python -m lab``: the laboratory's command line."""

from __future__ import annotations

import sys

from lab.commands.main import main

if __name__ == "__main__":
    sys.exit(main())
