"""`python -m clcache` is the command `clcache`."""

import sys

from .cli import main

sys.exit(main())
