"""`python -m polyida`: the command line."""

import sys

from polyida.cli import main

sys.exit(main())
