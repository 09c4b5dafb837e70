"""What a worker of a fleet imports: a fork server imports it once, and every worker starts as a copy of that process.

Nothing here may start a thread that computes, for a copy has none of them. (The one that pyarrow starts belongs to its
memory allocator, jemalloc, which sees to forks itself.)
"""

from __future__ import annotations

import gc
import os
import signal
from importlib import import_module

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # read as linear algebra is loaded
MODULES = (  # what most pipelines come to import; what is missing here each worker imports for itself
    "pyarrow.dataset",
    "ruamel.yaml",
    "errpipe.drivers.evaluation",
    "errpipe.fitting.history",
    "errpipe.verbs._fleet_machine",
)

signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends this process and its copies; the caller says so
if hasattr(signal, "pthread_sigmask"):
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
gc.disable()  # looking for garbage among what is being imported, all of which stays, takes a fifth of the time
os.environ.update(dict.fromkeys(THREADS, "1"))  # results and cores are then those of one machine each
for _name in MODULES:
    import_module(_name)
# Numba is imported, and compiled code read from its cache, at a kernel's first call.
_np, _noise = import_module("numpy"), import_module("errpipe.kernels.noise")
_noise.innovations(_np.zeros(2, dtype=_np.int64), _np.zeros((2, 1)), 0.5, 0.5)
gc.freeze()  # a collection would write to every page, and the copies would no longer share them
gc.enable()
