"""``python -m frog_blender.cli`` is ``frog``."""

import sys

from .main import main

if __name__ == "__main__":
    sys.exit(main())
