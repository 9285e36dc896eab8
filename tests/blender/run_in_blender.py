"""Run the tests of this folder inside a real Blender.

    blender -b --factory-startup --python tests/blender/run_in_blender.py -- [pytest's arguments]

Blender's Python needs pytest and safetensors.  Blender leaves with pytest's exit status.
"""

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
options = ["--import-mode=importlib", "-p", "no:cacheprovider", "--rootdir", str(HERE.parents[1])]
status = pytest.main([*options, *(arguments or ["-q", "-m", "not slow"]), str(HERE)])
sys.stdout.flush()
sys.stderr.flush()
os._exit(int(status))  # Blender itself ignores SystemExit's status unless started with --python-exit-code
