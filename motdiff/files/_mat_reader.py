"""Process in which SciPy reads a .mat file: the script of :mod:`motdiff.files.mat_files`.

    python -P _mat_reader.py FILE MIB SECONDS NAME...

Writes to stdout a line of JSON, ``{"sent": [name, ...], "found": [name, ...]}`` or ``{"error":
text}``, and then the arrays that are sent, in NumPy's file format. It imports nothing but NumPy
and SciPy.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any


def _limit(most_mib: int, most_s: int) -> None:
    """Let the system end this process where it takes too much memory or time."""
    try:
        import resource
    except ImportError:  # Windows: the other process still waits only so long
        return
    # RLIMIT_AS counts the address space that Python and SciPy have taken already
    process_bytes = 2**30
    statm = Path("/proc/self/statm")
    if statm.exists():
        process_bytes = int(statm.read_text().split()[0]) * resource.getpagesize()
    for kind, limit in (
        (resource.RLIMIT_AS, process_bytes + most_mib * 2**20),
        (resource.RLIMIT_CPU, most_s),
        (resource.RLIMIT_CORE, 0),  # a crash shall not leave a gigabyte behind
    ):
        soft, hard = resource.getrlimit(kind)
        bounds = [bound for bound in (limit, soft, hard) if bound != resource.RLIM_INFINITY]
        try:
            resource.setrlimit(kind, (min(bounds), hard))
        except (ValueError, OSError):  # macOS knows this limit and refuses to set it
            continue


def _read(path: str, names: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Return the arrays of those names, or where there are none, the names of the others."""
    from numpy import asarray
    from scipy.io import loadmat, whosmat

    # given a name, SciPy tries others when there is no such file
    with Path(path).open("rb") as stream:
        variables = loadmat(stream, variable_names=names)
        arrays = {name: asarray(variables[name]) for name in names if name in variables}
        variable_names = []
        if not arrays:
            stream.seek(0)
            variable_names = [str(name) for name, *_ in whosmat(stream)]
    for name, array in arrays.items():
        if array.dtype.hasobject or array.dtype.fields is not None:
            raise ValueError(
                f"variable {name} is a struct, a cell array or sparse, wanted a full array of"
                " numbers"
            )
    return arrays, variable_names


def _main(path: str, most_mib: str, most_s: str, *names: str) -> None:
    import scipy.io  # noqa: F401 - before the limit on memory, which is on what the file takes
    from numpy.lib.format import write_array

    _limit(int(most_mib), int(most_s))
    arrays: dict[str, Any] = {}
    answer: dict[str, str | list[str]]
    try:
        arrays, variable_names = _read(path, list(names))
        answer = {"sent": list(arrays), "found": variable_names}
    except MemoryError:
        answer = {"error": f"it needs more than {most_mib} MiB of memory"}
    except NotImplementedError:  # of all that SciPy does not read only this is in use
        answer = {"error": "version 7.3 is not read, save it with MATLAB's option -v7"}
    except Exception as error:
        answer = {"error": str(error) or type(error).__name__}
    pipe = sys.stdout.buffer
    pipe.write(json.dumps(answer).encode() + b"\n")
    for array in arrays.values():
        # given the pipe itself it would seek in it
        write_array(SimpleNamespace(write=pipe.write), array, allow_pickle=False)


if __name__ == "__main__":
    _main(*sys.argv[1:])
