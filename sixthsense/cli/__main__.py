"""`python -m sixthsense.cli`."""

import sys

from sixthsense.cli import main

sys.exit(main())
