"""Bring scans into one frame: ``python register.py source=a.ply target=b.ply output_dir=out``."""

from skipnet.commands.register import main

if __name__ == "__main__":
    raise SystemExit(main())
