"""`python -m robosim` is the command `robosim`."""

import sys

from robosim.cli.main import main

sys.exit(main())
