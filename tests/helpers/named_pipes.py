"""A named pipe for tests: whoever opens it, maybe again and again, finds it empty, and does not
wait for ever."""

import os
import threading
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def empty_pipe(path):
    """Make a pipe at ``path`` and write nothing into it, until the context is left."""
    path = Path(path)
    os.mkfifo(path)
    over = threading.Event()

    def write_nothing():
        while not over.is_set():
            path.open("wb").close()  # waits for a reader

    writer = threading.Thread(target=write_nothing)
    writer.start()
    try:
        yield path
    finally:
        over.set()
        reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        writer.join()
        os.close(reading)
