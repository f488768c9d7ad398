"""`python -m comparisons.cli` is `sindy-surge`."""

from __future__ import annotations

import sys

from comparisons.cli.parser import main

sys.exit(main())
