"""Lets ``python -m companion`` stand for the `companion` command."""

import sys

from companion.cli import main

sys.exit(main())
