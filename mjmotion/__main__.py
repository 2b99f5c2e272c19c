"""``python -m mjmotion`` is the same as ``mjmotion``."""

import sys

from mjmotion.cli.main import main

sys.exit(main())
