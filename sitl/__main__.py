"""Lets ``python -m sitl`` stand for the `sitl` command."""

import sys

from sitl.cli import main

sys.exit(main())
