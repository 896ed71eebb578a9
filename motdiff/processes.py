"""Processes that end with the one that started them, however that ends."""

from __future__ import annotations

import os
import signal
import threading
import time

_LOOK_S = 0.5  # between two looks at the parent
_GRACE_S = 3.0  # to put a shutter's controller to rest


def end_with_parent(parent: int) -> None:
    """Interrupt this process, and end it seconds later, once the process ``parent`` is gone.

    The system gives a process whose parent ended another one. On Windows it does not, and nothing
    is noticed there. ``parent``, a number, started this process, and may have ended already.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        signal.raise_signal(signal.SIGINT)
        time.sleep(_GRACE_S)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()
