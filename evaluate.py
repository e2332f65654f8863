"""Compare registration methods on the same pairs: ``python evaluate.py --help``."""

from skipnet.commands.evaluate import main

if __name__ == "__main__":
    raise SystemExit(main())
