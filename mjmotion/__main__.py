"""``python -m mjmotion`` is the same as ``mjmotion``."""

import sys

from mjmotion.cli import main

sys.exit(main())
