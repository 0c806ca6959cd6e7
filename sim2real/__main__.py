"""``python -m sim2real`` is the command line."""

import sys

from sim2real.cli import main

sys.exit(main())
