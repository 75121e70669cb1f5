"""Commands and scripts in processes of their own."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

# Thresholds of `gc`: very many objects of graphs are freed faster while a cache of the processor holds them
GARBAGE = 30_000, 20, 40
ROOT = Path(__file__).resolve().parents[2]


def run(*command, **options):
    """Output of a command; a test fails with what it complained of."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_python(code, folder, **environment):
    """Output of a fresh interpreter that imports the package and the support that these tests import."""
    environment = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]), **environment}
    code = textwrap.dedent(code)
    return run(sys.executable, "-c", code, cwd=folder, env=os.environ | environment, timeout=300).strip()
