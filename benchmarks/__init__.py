"""Experiments: each module measures one thing, prints its table and writes its result as JSON."""

import os

# Before NumPy is imported here and in the processes started from here, as in the services: several processes are busy
# at once, matrices are small, and threads of linear algebra that wait for each other cost more than they do.
for _library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
