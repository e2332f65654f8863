"""``python -m skipnet``: the console command."""

from skipnet.commands.main import main

if __name__ == "__main__":
    raise SystemExit(main())
