"""Learning as ``python -m services.learning`` starts it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

THREADS = """
import os
from pathlib import Path
import services.learning.__main__
import numpy as np
np.ones((800, 800)) @ np.ones((800, 800))
print(len(list(Path("/proc/self/task").iterdir())), os.environ["OMP_NUM_THREADS"])
"""


@pytest.mark.parametrize(("given", "told"), [({}, "1"), ({"OMP_NUM_THREADS": "2"}, "2")])
def test_linear_algebra_takes_one_thread_unless_told_otherwise(project: Path, given: dict[str, str], told: str) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", THREADS], cwd=project, env={**kept, **given}, capture_output=True, text=True, check=True
    )
    threads, limit = done.stdout.split()
    assert limit == told
    assert threads == "1" or given
