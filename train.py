"""Train the networks on simulated scenes: ``python train.py --help``."""

from skipnet.commands.train import main

if __name__ == "__main__":
    raise SystemExit(main())
