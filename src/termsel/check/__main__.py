"""Entry of ``python -m termsel.check``."""

from termsel.check import main

raise SystemExit(main())
